"use strict";
// Points, and what is drawn of them: a point is a pair, of px here, or of shares of the picture.

const SVG = "http://www.w3.org/2000/svg";

// How many different points there are.
export function distinct(points) {
  return new Set(points.map(String)).size;
}

function cross(a, b, c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

// Whether the outline of a polygon crosses itself.
export function sidesCross(points) {
  const sides = points.map((point, place) => [point, points[(place + 1) % points.length]]);
  return sides.some(([a, b], i) => sides.some(([c, d], j) => j > i + 1 && !(i === 0 && j === sides.length - 1)
    && cross(a, b, c) * cross(a, b, d) < 0 && cross(c, d, a) * cross(c, d, b) < 0));
}

// A share as the file has it.
export function bounded(share) {
  return Math.round(Math.min(Math.max(share, 0), 1) * 1e4) / 1e4;
}

// An element of a drawing.
export function made(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

// Text at a place, but inside a picture of that size.
export function label([x, y], text, [width, height]) {
  return made("text", { x: Math.min(Math.max(x, 20), width - 20), y: Math.min(Math.max(y, 12), height - 12) }, text);
}

// The words for the two sides of a line, as somebody sees them who looks along it from its first point.
export function sides(points, size) {
  let longest = 1; // the longest part of the line has room for both words
  const length = (place) => Math.hypot(points[place][0] - points[place - 1][0], points[place][1] - points[place - 1][1]);
  for (let place = 2; place < points.length; place += 1) if (length(place) > length(longest)) longest = place;
  const [[ax, ay], [bx, by]] = [points[longest - 1], points[longest]];
  const far = 26 / Math.max(length(longest), 1);
  const [x, y, dx, dy] = [(ax + bx) / 2, (ay + by) / 2, (bx - ax) * far, (by - ay) * far];
  return [label([x + dy, y - dx], "left", size), label([x - dy, y + dx], "right", size)];
}

export function middle(points) {
  const sums = points.reduce(([x, y], point) => [x + point[0], y + point[1]], [0, 0]);
  return sums.map((sum) => sum / points.length);
}
