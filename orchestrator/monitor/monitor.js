"use strict";
// Asks for the status twice a second and writes into a card a stream what has changed.

const PAUSE = 500; // ms
const ENDED = ["done", "partial", "failed"];
const summary = document.getElementById("summary");
const waiting = document.getElementById("waiting");
const pause = document.getElementById("pause");
const list = document.getElementById("streams");
const cards = []; // in the order of the list of streams
const large = document.querySelector("dialog");
const [largeImage, film, noClip] = ["img", "video", "p"].map((name) => large.querySelector(name));
let enlarged = null; // the picture that is shown large
// Only what can be seen is loaded, however many streams there are.
const inSight = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    entry.target.classList.toggle("in-sight", entry.isIntersecting);
    if (entry.isIntersecting) load(entry.target.querySelector(".picture img"));
  }
}, { rootMargin: "200px" });

function write(element, text) {
  if (element.textContent !== text) element.textContent = text; // else a screen reader would repeat it
}

function card(number) {
  if (!cards[number]) {
    const copy = document.getElementById("stream").content.cloneNode(true).firstElementChild;
    copy.querySelector("h2").id = `name-${number}`;
    copy.setAttribute("aria-labelledby", `name-${number}`);
    copy.querySelector(".picture").addEventListener("click", (click) => enlarge(click.currentTarget.firstChild));
    list.append(copy);
    inSight.observe(copy);
    cards[number] = copy;
  }
  return cards[number];
}

function clock(seconds) {
  const whole = Math.round(seconds);
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return parts.map((part) => String(part).padStart(2, "0")).join(":");
}

function shownNumber(stream, key) {
  const value = stream[key];
  if (key === "read" && stream.length !== null && !ENDED.includes(stream.state)) return `${value} of ${stream.length}`;
  if (key === "seconds_left") return value === null ? "–" : clock(value);
  if (key === "frames_per_second") return value ? value.toFixed(1) : "–";
  if (key === "latency_ms") return value ? value.toFixed(0) : "–";
  return String(value);
}

function drawLayers(figure, points) {
  figure.hidden = points.length < 2;
  if (figure.hidden) return;
  const [first, last] = [points[0][0], points[points.length - 1][0]];
  const most = Math.max(...points.map((point) => point[1]));
  const places = points.map(([read, layers]) =>
    `${(240 * (read - first) / Math.max(last - first, 1)).toFixed(1)},${(39 - 37 * layers / most).toFixed(1)}`);
  figure.querySelector("path").setAttribute("d", `M0,39L${places.join("L")}L240,39Z`);
  write(figure.querySelector("figcaption"), `layers over time, at most ${most}`);
}

function load(image) {
  if (image.dataset.newest && image.getAttribute("src") !== image.dataset.newest) image.src = image.dataset.newest;
  if (image === enlarged) showLarge(image.src, image.alt);
}

function reveal(part) {
  for (const one of [largeImage, film, noClip]) one.hidden = one !== part;
}

function showLarge(source, words) {
  if (largeImage.getAttribute("src") !== source) largeImage.src = source;
  largeImage.alt = words;
  reveal(largeImage);
}

function play(source) {
  enlarged = null;
  film.src = source;
  reveal(film);
  large.showModal();
}

function enlarge(image) {
  enlarged = image;
  showLarge(image.src, image.alt);
  large.showModal();
}

function describe(event) {
  const when = event.clock ? new Date(event.clock).toLocaleTimeString() : `${event.time.toFixed(1)} s`;
  const who = event.object === null ? "" : ` ${event.object}`;
  const where = event.zone === null ? "" : ` ${event.zone}`;
  if (event.kind === "fault") return `${when}: ${event.reason}`;
  const what = event.kind === "rule" ? event.rule : event.kind;
  return `${when}:${who} ${what}${where}${event.direction ? ` to the ${event.direction}` : ""}`;
}

function listEvents(box, stream) {
  box.hidden = !stream.events.length;
  const newest = box.hidden ? "" : stream.events[stream.events.length - 1].id;
  if (box.dataset.newest === newest) return;
  box.dataset.newest = newest;
  write(box.querySelector("summary"), `last events: ${describe(stream.events[stream.events.length - 1])}`);
  box.querySelector("ol").replaceChildren(...stream.events.slice().reverse().map((event) => {
    const line = document.createElement("li");
    write(line, describe(event));
    const record = `records/${encodeURIComponent(stream.name)}`;
    if (event.picture) {
      const picture = document.createElement("button");
      const image = document.createElement("img");
      image.loading = "lazy";
      image.src = `${record}/${event.picture}`;
      image.alt = "picture";
      picture.type = "button";
      picture.className = "of-event";
      picture.addEventListener("click", () => {
        enlarged = null;
        showLarge(image.src, describe(event));
        large.showModal();
      });
      picture.append(image);
      line.prepend(picture, " ");
    }
    if (event.clip) {
      const clip = document.createElement("a");
      write(clip, "clip");
      clip.href = `${record}/${event.clip}`;
      clip.addEventListener("click", (click) => {
        click.preventDefault();
        play(clip.href);
      });
      line.append(" ", clip);
    }
    return line;
  }));
}

function hourOf(row) {
  return row.begins ? Date.parse(row.begins) / 3600000 : Number(row.hour);
}

function nameOfHour(row) {
  return row.begins ? new Date(row.begins).toLocaleString([], { dateStyle: "short", timeStyle: "short" }) : `hour ${row.hour}`;
}

// What is drawn of a place: the name, the column, and the class of its bars.
const BARS = {
  picture: [["born", "born", "one"]],
  zone: [["entered", "entered", "one"]],
  line: [["to the left", "crossed_left", "one"], ["to the right", "crossed_right", "two"]],
};

// A day of bars, the newest hour at the right, one number upon the other.
function drawBars(rows) {
  const [{ place, kind }] = rows, last = hourOf(rows[rows.length - 1]);
  const shown = rows.filter((row) => hourOf(row) > last - 24);
  const sum = (row) => BARS[kind].reduce((all, [, column]) => all + Number(row[column]), 0);
  const most = Math.max(1, ...shown.map(sum));
  const figure = document.createElement("figure");
  const drawing = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [name, value] of [["viewBox", "0 0 240 40"], ["preserveAspectRatio", "none"], ["role", "img"]]) {
    drawing.setAttribute(name, value);
  }
  const words = BARS[kind].map(([name, column]) =>
    `${name} ${shown.reduce((all, row) => all + Number(row[column]), 0)}`).join(", ");
  drawing.setAttribute("aria-label", `${place || "whole picture"}: ${words}; at most ${most} an hour`);
  for (const row of shown) {
    let foot = 40;
    for (const [name, column, style] of BARS[kind]) {
      const bar = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      const height = 38 * Number(row[column]) / most;
      foot -= height;
      const box = { x: 10 * (23 - last + hourOf(row)) + 1, y: foot, width: 8, height, class: style };
      for (const [key, value] of Object.entries(box)) bar.setAttribute(key, value);
      const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
      write(title, `${nameOfHour(row)}: ${row[column]} ${name}`);
      bar.append(title);
      drawing.append(bar);
    }
  }
  const caption = document.createElement("figcaption");
  caption.append(`${place || "whole picture"}: `);
  BARS[kind].forEach(([name, column, style], number) => {
    const words = document.createElement("span");
    words.className = style;
    write(words, `${name} ${shown.reduce((all, row) => all + Number(row[column]), 0)}`);
    caption.append(number ? ", " : "", words);
  });
  const dropped = Number(rows[rows.length - 1].dropped_share);
  if (dropped > 0.01) caption.append(`; ${Math.round(100 * dropped)} % of frames dropped`);
  figure.append(drawing, caption);
  return figure;
}

function drawHeat(canvas, heat, image) {
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (image.naturalWidth) {
    canvas.height = Math.round(canvas.width * image.naturalHeight / image.naturalWidth);
    pen.globalAlpha = 0.5;
    pen.drawImage(image, 0, 0, canvas.width, canvas.height);
  }
  const most = Math.log1p(Math.max(0, ...heat.label_maps));
  const [width, height] = [canvas.width / heat.columns, canvas.height / heat.rows];
  heat.label_maps.forEach((number, cell) => {
    if (!number) return;
    const share = Math.log1p(number) / most; // a few seconds should be seen beside an hour
    pen.globalAlpha = 0.25 + 0.6 * share;
    pen.fillStyle = `hsl(${Math.round(55 - 55 * share)} 95% 50%)`;
    pen.fillRect(cell % heat.columns * width, Math.floor(cell / heat.columns) * height, width + 0.5, height + 0.5);
  });
  canvas.setAttribute("aria-label", `Cells in which objects stood: ${heat.label_maps.filter(Boolean).length} of ${heat.label_maps.length}`);
}

async function showCounts(box, stream, image) {
  box.hidden = !stream.counts;
  if (!box.open || box.dataset.newest === stream.counts) return;
  box.dataset.newest = stream.counts;
  const counts = await (await fetch(`streams/${encodeURIComponent(stream.name)}/counts.json`)).json();
  const places = new Map();
  for (const row of counts.hours) places.set(row.place, [...(places.get(row.place) || []), row]);
  box.querySelector(".places").replaceChildren(...[...places.values()].map(drawBars));
  if (image.src) await image.decode().catch(() => {}); // without it the map is drawn alone
  drawHeat(box.querySelector("canvas"), counts.heat, image);
}

function show(stream, number) {
  const element = card(number);
  element.dataset.state = stream.state;
  write(element.querySelector("h2"), stream.name);
  write(element.querySelector(".state"), stream.state);
  const waits = element.querySelector(".waits");
  waits.hidden = !stream.waits_for;
  write(waits, stream.waits_for ? `waits for ${stream.waits_for}` : "");
  const error = element.querySelector(".error");
  error.hidden = !stream.error;
  write(error, stream.error || "");
  for (const figure of element.querySelectorAll("dd")) write(figure, shownNumber(stream, figure.dataset.key));
  for (const rare of element.querySelectorAll(".rare")) rare.hidden = !stream[rare.lastElementChild.dataset.key];
  const image = element.querySelector(".picture img");
  if (stream.picture) {
    image.dataset.newest = `pictures/${number}.jpg?${stream.picture}`;
    image.alt = `Newest frame of ${stream.name} with its objects outlined and numbered`;
    if (element.classList.contains("in-sight") || image === enlarged) load(image);
  }
  element.querySelector(".picture").hidden = !stream.picture;
  drawLayers(element.querySelector("figure"), stream.layers_over_time);
  element.querySelector(".zones").href = `zones/${encodeURIComponent(stream.name)}`;
  listEvents(element.querySelector(".events"), stream);
  showCounts(element.querySelector(".counts"), stream, image).catch(() => {}); // the run has ended
}

function describeBacklog(target) {
  const words = [];
  if (target.away_since) {
    const count = `${target.waiting} ${target.waiting === 1 ? "event waits" : "events wait"} for ${target.target}`;
    words.push(`${count}, away since ${new Date(target.away_since).toLocaleTimeString()}`);
  }
  if (target.refused) {
    words.push(`${target.refused} ${target.refused === 1 ? "event" : "events"} refused by ${target.target}`);
  }
  return words.join("; ");
}

// Those at work first. The cards themselves change places, so that a screen reader reads what the eye sees.
function arrange(streams) {
  while (cards.length > streams.length) cards.pop().remove(); // one was taken from the list
  const numbers = [...streams.keys()].sort((a, b) => streams[a].rank - streams[b].rank || a - b);
  numbers.forEach((number, place) => {
    if (list.children[place] !== cards[number]) list.insertBefore(cards[number], list.children[place]);
    const before = streams[numbers[place - 1]];
    cards[number].classList.toggle("first", before !== undefined && before.rank !== streams[number].rank);
  });
  return numbers.map((number) => streams[number]);
}

async function refresh() {
  if (pause.getAttribute("aria-pressed") === "false") {
    try {
      const answer = await fetch("status.json");
      const status = await answer.json();
      status.streams.forEach(show);
      const troubled = status.events.filter((target) => target.away_since || target.refused);
      waiting.hidden = !troubled.length;
      write(waiting, troubled.map(describeBacklog).join("; "));
      const counts = new Map();
      for (const stream of arrange(status.streams)) counts.set(stream.state, (counts.get(stream.state) || 0) + 1);
      write(summary, [...counts].map(([state, count]) => `${count} ${state}`).join(", "));
    } catch {
      write(summary, "The run has ended, or cannot be reached; this is how it stood last.");
    }
  }
  setTimeout(refresh, PAUSE);
}

pause.addEventListener("click", () => {
  const paused = pause.getAttribute("aria-pressed") === "false";
  pause.setAttribute("aria-pressed", String(paused));
});
film.addEventListener("error", () => reveal(noClip));
large.addEventListener("close", () => {
  enlarged = null;
  film.removeAttribute("src");
  film.load(); // so that nothing more of it is fetched
});
large.addEventListener("click", (click) => {
  if (click.target !== film && click.target !== large.querySelector("button")) large.close();
});
refresh();
