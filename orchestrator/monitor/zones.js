"use strict";
// Draws zones over a still picture. A point is a pair of shares of its width and height, as in the file.

import { bounded, distinct, label, made, middle, sides } from "./zone_shapes.js";
import { LEAST, faultOf, remarksOn } from "./zone_words.js";

const NEAR = 8; // px, within which two clicks are one point
const STEP = 0.01; // of the picture, that an arrow key moves a point
const part = (id) => document.getElementById(id);
const [stage, list, note, help, fault] = ["stage", "list", "note", "help", "fault"].map(part);
const image = stage.querySelector("img");
const canvas = stage.querySelector("svg > g");
const itself = `./${location.pathname.split("/").pop()}.json`;

let zones = []; // each: name, kind, polygon, fixed_to, rules, was, moved
let known = { pictures: [], may_write: false, version: "" };
let saved = "[]"; // the zones as the file has them
let chosen = null; // place of the zone whose corners can be moved
let draft = null; // what is being drawn: kind, points, aim
let dragged = null; // a corner that follows the pointer: points, place
let past = []; // the zones before each change
let isTyping = false; // so that a name is one change

// What is there, and what is wrong with it

function isMovable(zone) {
  return known.may_write && zone.polygon !== null && zone.fixed_to === "picture";
}

function remember() {
  write(fault, "");
  past.push(JSON.stringify(zones));
  isTyping = false;
}

function undo() {
  write(fault, "");
  if (draft) {
    if (draft.points.length) draft.points.pop();
    else draft = null;
  } else if (past.length) {
    zones = JSON.parse(past.pop());
    [chosen, isTyping] = [null, false];
  }
  show();
}

// Drawing on the picture

function size() {
  return [stage.clientWidth, stage.clientHeight];
}

function inPixels(point) {
  return [point[0] * size()[0], point[1] * size()[1]];
}

function at(event) {
  const box = stage.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map(bounded);
}

function areNear(a, b) {
  const [p, q] = [inPixels(a), inPixels(b)];
  return Math.hypot(p[0] - q[0], p[1] - q[1]) < NEAR;
}

function begin(kind) {
  draft = draft && draft.kind === kind ? null : { kind, points: [], aim: null };
  chosen = null;
  write(fault, "");
  show();
  if (draft) stage.focus();
}

function add(point) {
  const points = draft.points;
  write(fault, "");
  if (points.length && areNear(point, points[points.length - 1])) return;
  if (draft.kind === "zone" && points.length >= LEAST.zone && areNear(point, points[0])) {
    finish();
    return;
  }
  points.push(point);
  show();
}

function freeName(kind) {
  let number = 1;
  while (zones.some((zone) => zone.name === `${kind} ${number}`)) number += 1;
  return `${kind} ${number}`;
}

function finish() {
  if (!draft) return;
  const { kind, points } = draft;
  if (distinct(points) < LEAST[kind]) {
    write(fault, `A ${kind} needs at least ${LEAST[kind]} different points; click where they are.`);
    return;
  }
  remember();
  zones.push({ name: freeName(kind), kind, polygon: points, fixed_to: "picture", rules: [], was: null, moved: true });
  draft = null;
  chosen = zones.length - 1;
  show();
  const name = list.lastElementChild.querySelector("input");
  name.focus({ preventScroll: true }); // the picture stays where it is; the name appears on it as it is typed
  name.select();
}

function remove(place) {
  remember();
  zones.splice(place, 1);
  chosen = null;
  show();
}

function turn(place) {
  remember();
  zones[place].polygon.reverse();
  zones[place].moved = true;
  show();
}

function grips(zone) {
  const points = zone.polygon;
  const between = points.slice(0, zone.kind === "line" ? -1 : undefined).map((point, place) => {
    const grip = dot(middle([point, points[(place + 1) % points.length]]), 5, "between grip");
    grip.addEventListener("pointerdown", (event) => {
      remember();
      points.splice(place + 1, 0, at(event));
      drag(event, zone, place + 1);
    });
    return grip;
  });
  const corners = points.map((point, place) => {
    const words = `Point ${place + 1} of ${zone.name}: ${point.map((share) => `${(100 * share).toFixed(1)} %`).join(", ")}`;
    const corner = made("g", { tabindex: 0, role: "button", "aria-label": `${words}; arrow keys move it, Delete removes it` });
    corner.append(dot(point, 16, "grip"), dot(point, 6, "corner"));
    corner.addEventListener("pointerdown", (event) => {
      remember();
      drag(event, zone, place);
    });
    corner.addEventListener("keydown", (event) => changeByKey(event, zone, place));
    return corner;
  });
  return [...between, ...corners];
}

function drag(event, zone, place) {
  event.stopPropagation();
  event.preventDefault();
  stage.setPointerCapture(event.pointerId);
  dragged = { zone, place };
  zone.moved = true;
  show();
}

function arrow(event) {
  const step = event.shiftKey ? STEP / 5 : STEP;
  return { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
}

function changeByKey(event, zone, place) {
  const by = arrow(event);
  const removes = ["Delete", "Backspace"].includes(event.key) && zone.polygon.length > LEAST[zone.kind];
  if (!by && !removes) return;
  event.preventDefault();
  remember();
  zone.moved = true;
  if (removes) zone.polygon.splice(place, 1);
  else zone.polygon[place] = zone.polygon[place].map((share, axis) => bounded(share + by[axis]));
  show();
  canvas.querySelectorAll(".chosen g")[Math.min(place, zone.polygon.length - 1)].focus();
}

function outline(kind, points, style) {
  const isLine = kind === "line";
  return made(isLine ? "polyline" : "polygon", { points: points.join(" "), class: isLine ? `${style} of-line` : style });
}

function dot(point, r, style) {
  const [cx, cy] = inPixels(point);
  return made("circle", { cx, cy, r, class: style });
}

function drawn(zone, place) {
  const group = made("g", { class: `${place === chosen ? "chosen" : ""} ${zone.fixed_to === "scene" ? "of-scene" : ""}` });
  if (!zone.polygon) return group;
  const pixels = zone.polygon.map(inPixels);
  const isLine = zone.kind === "line";
  const shape = outline(zone.kind, pixels, "shape");
  group.append(shape);
  if (isLine) {
    shape.setAttribute("marker-end", "url(#head)");
    group.append(outline(zone.kind, pixels, "wide"), ...sides(pixels, size()));
  }
  group.append(label(isLine ? [pixels[0][0], pixels[0][1] - 14] : middle(pixels), zone.name, size()));
  group.addEventListener("pointerdown", (event) => {
    if (draft) return; // a zone may be drawn over another one
    event.preventDefault();
    choose(place);
  });
  if (place === chosen && isMovable(zone)) group.append(...grips(zone));
  return group;
}

function drawDraft() {
  const points = [...draft.points, ...(draft.aim ? [draft.aim] : [])].map(inPixels);
  const parts = [outline(draft.kind, points, "draft"), ...draft.points.map((point) => dot(point, 5, "corner"))];
  if (draft.kind === "line" && points.length > 1) parts.push(...sides(points, size()));
  if (draft.aim) {
    const [x, y] = inPixels(draft.aim);
    parts.push(made("path", { d: `M${x - 9},${y}H${x + 9}M${x},${y - 9}V${y + 9}`, class: "aim" }));
  }
  return parts;
}

// The page around it

function write(element, text) {
  if (element.textContent !== text) element.textContent = text; // else a screen reader would repeat it
}

function choose(place) {
  if (chosen === place) return;
  chosen = place;
  show();
}

function row(place) {
  const zone = zones[place];
  const element = part("row").content.firstElementChild.cloneNode(true);
  const [kind, name, remover, turner] = [".kind", "input", ".delete", ".turn"].map((one) => element.querySelector(one));
  kind.textContent = zone.kind;
  name.value = zone.name;
  name.disabled = remover.hidden = !known.may_write;
  turner.hidden = zone.kind !== "line" || !isMovable(zone);
  name.addEventListener("focus", () => choose(place));
  name.addEventListener("input", () => {
    if (!isTyping) remember();
    isTyping = true;
    zones[place].name = name.value.trim();
    show();
  });
  name.addEventListener("blur", () => { isTyping = false; });
  remover.addEventListener("click", () => remove(place));
  turner.addEventListener("click", () => turn(place));
  return element;
}

function showList() {
  const shape = JSON.stringify(zones.map((zone) => [zone.was, zone.kind, isMovable(zone)]));
  if (list.dataset.shape !== shape) { // the rows stay while somebody types in one
    list.replaceChildren(...zones.map((_, place) => row(place)));
    list.dataset.shape = shape;
  }
  zones.forEach((zone, place) => {
    const element = list.children[place];
    element.classList.toggle("chosen", place === chosen);
    const name = element.querySelector("input");
    if (name.value.trim() !== zone.name) name.value = zone.name;
    name.setAttribute("aria-label", `Name of ${zone.kind} ${place + 1}`);
    for (const one of element.querySelectorAll("button")) one.setAttribute("aria-label", `${one.textContent} of ${zone.name}`);
    write(element.querySelector(".remarks"), remarksOn(zone));
    write(element.querySelector(".fault"), faultOf(zone, zones));
  });
}

function showTools() {
  for (const kind of ["zone", "line"]) {
    part(kind).disabled = !known.may_write;
    part(kind).setAttribute("aria-pressed", String(draft !== null && draft.kind === kind));
  }
  part("finish").disabled = !draft || distinct(draft.points) < LEAST[draft.kind];
  part("undo").disabled = !draft && !past.length;
  part("save").disabled = !known.may_write || draft !== null || !isChanged();
  stage.classList.toggle("drawing", draft !== null);
  stage.classList.toggle("editable", known.may_write);
  const words = draft
    ? "Click to add a point, or move the cross with the arrow keys and press Space; double-click or Enter ends, Escape takes the last point back."
    : "Choose a zone to move its points by dragging them; the small ones between add a point. Escape takes the last change back.";
  write(help, known.may_write ? words : "");
}

function show() {
  canvas.replaceChildren(...zones.map(drawn), ...(draft ? drawDraft() : []));
  showList();
  showTools();
}

function asSent() {
  return zones.map(({ name, kind, polygon, was, moved }) => ({ name, kind, polygon: moved ? polygon : null, was }));
}

function isChanged() {
  return JSON.stringify(asSent()) !== saved;
}

function take(answer) {
  known = answer;
  zones = answer.zones.map((zone) => ({ ...zone, was: zone.name, moved: false }));
  saved = JSON.stringify(asSent());
  [draft, chosen, past, isTyping] = [null, null, [], false];
  write(document.querySelector("h1"), `Zones of ${answer.stream}`);
  document.title = `Zones of ${answer.stream}`;
  image.alt = `Picture of ${answer.stream}`;
  write(note, answer.note);
  show();
}

async function save() {
  const wrong = zones.map((zone) => faultOf(zone, zones)).find((words) => words);
  if (wrong) {
    write(fault, `Not saved. ${wrong}`);
    return;
  }
  part("save").disabled = true;
  try {
    const answer = await fetch(itself, {
      method: "PUT",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ zones: asSent(), version: known.version }),
    });
    if (answer.ok) {
      take(await answer.json());
      write(note, `Saved. ${known.note}`);
      return;
    }
    write(fault, `Not saved. ${await answer.text()}`);
  } catch {
    write(fault, "Not saved: the run has ended, or cannot be reached.");
  }
  part("save").disabled = false;
}

// The best picture that there is: a still without anything drawn on it, else the newest one of the live page.
async function loadPicture(again = 0) {
  for (const path of known.pictures) {
    const next = new Image();
    next.src = `../${path}?${Date.now()}`;
    const isThere = await next.decode().then(() => true, () => false);
    if (!isThere) continue;
    image.src = next.src;
    stage.style.setProperty("--aspect", String(next.naturalWidth / next.naturalHeight));
    if (again) setTimeout(loadPicture, 2500, again - 1); // asking for a still makes a newer one
    return;
  }
  write(help, "There is no picture of this stream yet.");
  setTimeout(loadPicture, 2000);
}

stage.addEventListener("pointerdown", (event) => {
  if (!draft) {
    if (event.target === image || event.target.closest("g") === null) choose(null);
    return;
  }
  event.preventDefault();
  stage.focus();
  if (event.button === 0) add(at(event));
});
stage.addEventListener("pointermove", (event) => {
  if (dragged) {
    dragged.zone.polygon[dragged.place] = at(event);
    show();
  } else if (draft && event.pointerType !== "touch") {
    draft.aim = at(event);
    show();
  }
});
for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { dragged = null; });
stage.addEventListener("dblclick", finish);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && event.target.tagName !== "INPUT") undo();
  if (!draft || event.target !== stage) return;
  const by = arrow(event);
  if (event.key === "Enter") finish();
  else if (event.key === " ") add(draft.aim || [0.5, 0.5]);
  else if (by) {
    draft.aim = (draft.aim || [0.5, 0.5]).map((share, axis) => bounded(share + by[axis]));
    show();
  } else return;
  event.preventDefault();
});
for (const kind of ["zone", "line"]) part(kind).addEventListener("click", () => begin(kind));
part("finish").addEventListener("click", finish);
part("undo").addEventListener("click", undo);
part("save").addEventListener("click", save);
part("picture").addEventListener("click", () => loadPicture(1));
new ResizeObserver(show).observe(stage);
window.addEventListener("beforeunload", (event) => {
  if (isChanged()) event.preventDefault();
});

fetch(itself).then((answer) => answer.json()).then((answer) => {
  take(answer);
  loadPicture(1);
}).catch(() => write(note, "The run has ended, or cannot be reached."));
