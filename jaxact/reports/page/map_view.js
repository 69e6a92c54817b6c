// The stability map over the gains: the exact boundary, level lines, and the point that one moves.

import { drawCells } from "./cells.js";
import { draw, frame, line, table } from "./chart.js";
import { draggable } from "./dragging.js";
import { fields, levelLine, QUANTITIES, regionAbove } from "./levels.js";
import { gainUnits } from "./words.js";

// Gains along each axis: of the first map after a change, and of the one that replaces it.
export const COARSE = 16;
export const FINE = 48;
const HEIGHT = 430;
const STEP = 0.01;

/**
 * What of the map does not depend on the point: level lines and the stable region, in cells of
 * `count` x `count` gains.
 */
export function mapLayers(loop, cached, window, quantity, count) {
  const { values, distance } = fields(loop, cached, window, quantity, count);
  const { levels, text, field } = QUANTITIES[quantity];
  const lines = levels
    .map((level) => ({ text: text(level), segments: levelLine(values, count, field(level)) }))
    .filter(({ segments }) => segments.length > 0);
  return { lines, region: regionAbove(distance, count), count };
}

const along = ([low, high], cell, count) => low * (high / low) ** (cell / (count - 1));

/**
 * Draw the map. `edges` of `boundary`, `points` [{name, kp, kd}], `point` {kp, kd}; `cells` of one
 * `loop` of a sweep instead of the stable region, null for none.
 */
export function drawMap(svg, { window, unit, layers, edges, points, point, cells, loop }) {
  const [stiff, damping] = gainUnits(unit);
  const place = frame(svg, {
    x: { domain: window.kp, log: true, label: `kp, stiffness [${stiff}]` },
    y: { domain: window.kd, log: true, label: `kd, damping [${damping}]` },
    height: HEIGHT,
  });
  const { count } = layers;
  const spot = (x, y) => [
    place.x(along(window.kp, x, count)),
    place.y(along(window.kd, y, count)),
  ];
  const at = (x, y) => {
    const [across, up] = spot(x, y);
    return `${across.toFixed(1)} ${up.toFixed(1)}`;
  };
  const filled = layers.region.map((cell) => {
    let path = "";
    for (let i = 0; i < cell.length; i += 2) path += `${i ? "L" : "M"}${at(cell[i], cell[i + 1])}`;
    return `${path}Z`;
  });
  if (cells) drawCells(place, cells, loop);
  else place.inside.append(draw("path", { class: "stable", d: filled.join("") }));
  const labels = [];
  for (const { text, segments } of layers.lines) {
    const path = segments.map(([x0, y0, x1, y1]) => `M${at(x0, y0)}L${at(x1, y1)}`).join("");
    place.inside.append(draw("path", { class: "level", d: path }));
    const [x, y] = spot(...labelled(segments, count));
    // No label over another.
    if (labels.some((one) => Math.abs(one.y - y) < 13 && Math.abs(one.x - x) < 45)) continue;
    labels.push({ x, y });
    place.inside.append(draw("text", { class: "level-label", x: x + 3, y: y - 3 }, text));
  }
  for (const { kp, kd, separates } of edges) {
    line(place, kp, kd, { class: separates ? "boundary" : "inner" });
  }
  for (const { name, kp, kd } of points) place.inside.append(...star(place, name, kp, kd));
  const [x, y] = [place.x(point.kp), place.y(point.kd)];
  place.inside.append(
    draw("line", { class: "hair", x1: x, x2: x, y1: place.top, y2: place.bottom }),
    draw("line", { class: "hair", x1: place.left, x2: place.right, y1: y, y2: y }),
    draw("circle", { class: "point", cx: x, cy: y, r: 7 }),
  );
  return place;
}

/** The topmost end of a level line, away from the edges of the map. */
function labelled(segments, count) {
  const [right, top] = [0.92 * count, 0.94 * count];
  const inside = segments.filter(([x, y]) => x > 1 && x < right && y < top);
  return (inside.length ? inside : segments).reduce((a, b) => (b[1] > a[1] ? b : a)).slice(0, 2);
}

function star(place, name, kp, kd) {
  const [x, y] = [place.x(kp), place.y(kd)];
  return [
    draw("path", { class: "mark", d: `M${x - 6} ${y}L${x} ${y - 6}L${x + 6} ${y}L${x} ${y + 6}Z` }),
    draw("text", { class: "mark-label", x: x + 9, y: y - 7 }, name),
  ];
}

/** The boundary as a table, at most 60 rows. */
export function mapTable(edges, unit) {
  const [stiff, damping] = gainUnits(unit);
  const rows = edges
    .filter(({ separates }) => separates)
    .flatMap(({ kp, kd, w }) => kp.map((value, i) => [value, kd[i], w[i]]));
  const stride = Math.max(1, Math.ceil(rows.length / 60));
  const kept = rows.filter((_, i) => i % stride === 0);
  const columns = [`kp [${stiff}]`, `kd [${damping}]`, "frequency of the marginal root [rad/s]"];
  return table(
    "The exact stability boundary",
    columns.map((head, i) => ({ head, values: kept.map((row) => row[i]) })),
  );
}

/** Let the point follow pointer and arrow keys; `moved(kp, kd)` is called with gains inside. */
export function movable(pad, svg, window, place, point, moved) {
  const clamp = (value, [low, high]) => Math.min(Math.max(value, low), high);
  const go = (kp, kd) => moved(clamp(kp, window.kp), clamp(kd, window.kd));
  draggable(pad, svg, (x, y) => go(...place().invert(x, y)));
  pad.addEventListener("keydown", (event) => {
    const directions = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowDown: [0, -1],
      ArrowUp: [0, 1],
    };
    const direction = directions[event.key];
    if (!direction) return;
    event.preventDefault();
    const by = STEP * (event.shiftKey ? 10 : 1);
    const { kp, kd } = point();
    const step = (value, [low, high], sign) => value * (high / low) ** (sign * by);
    go(step(kp, window.kp, direction[0]), step(kd, window.kd, direction[1]));
  });
}
