"use strict";
// Asks for the status once a second and writes into a card a stream what has changed.

const SECOND = 1000;
const ENDED = ["done", "partial", "failed"];
const summary = document.getElementById("summary");
const pause = document.getElementById("pause");
const list = document.getElementById("streams");
const cards = []; // in the order of the list of streams

function write(element, text) {
  if (element.textContent !== text) element.textContent = text; // else a screen reader would repeat it
}

function card(number) {
  if (!cards[number]) {
    const copy = document.getElementById("stream").content.cloneNode(true).firstElementChild;
    copy.querySelector("h2").id = `name-${number}`;
    copy.setAttribute("aria-labelledby", `name-${number}`);
    list.append(copy);
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
  const image = element.querySelector("img");
  if (stream.picture && image.dataset.picture !== stream.picture) {
    image.dataset.picture = stream.picture;
    image.src = `/pictures/${number}.jpg?${stream.picture}`;
    image.alt = `Newest frame of ${stream.name} with its objects outlined and numbered`;
  }
  image.hidden = !stream.picture;
  drawLayers(element.querySelector("figure"), stream.layers_over_time);
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
      const answer = await fetch("/status.json");
      const status = await answer.json();
      status.streams.forEach(show);
      const counts = new Map();
      for (const stream of arrange(status.streams)) counts.set(stream.state, (counts.get(stream.state) || 0) + 1);
      write(summary, [...counts].map(([state, count]) => `${count} ${state}`).join(", "));
    } catch {
      write(summary, "The run has ended, or cannot be reached; this is how it stood last.");
    }
  }
  setTimeout(refresh, SECOND);
}

pause.addEventListener("click", () => {
  const paused = pause.getAttribute("aria-pressed") === "false";
  pause.setAttribute("aria-pressed", String(paused));
});
refresh();
