"use strict";
// What is said of zones.

import { distinct, sidesCross } from "./zone_shapes.js";

export const LEAST = { zone: 3, line: 2 }; // points

// What is wrong with one of some zones, a sentence; empty if nothing is.
export function faultOf(zone, zones) {
  if (!zone.name.trim()) return `A ${zone.kind} has no name.`;
  if (zones.filter((one) => one.name === zone.name).length > 1) return `Two are named “${zone.name}”.`;
  if (zone.polygon && distinct(zone.polygon) < LEAST[zone.kind]) {
    return `“${zone.name}” needs at least ${LEAST[zone.kind]} different points.`;
  }
  const broken = zone.was !== null && zone.was !== zone.name ? zone.rules : [];
  return broken.length ? `Of “${zone.was}” there is a rule, ${broken.join(", ")}: rename it in the file.` : "";
}

// What else is to be known of a zone.
export function remarksOn(zone) {
  const remarks = [];
  if (zone.rules.length) remarks.push(`rules: ${zone.rules.join(", ")}`);
  if (zone.fixed_to === "scene") remarks.push("goes with the camera; shown as in the stream's first picture, moved in the file");
  if (!zone.polygon) remarks.push("written in px; shown once there is a still of the camera");
  if (zone.kind === "zone" && zone.polygon && sidesCross(zone.polygon)) remarks.push("its sides cross: what is enclosed twice is outside");
  return remarks.join("; ");
}
