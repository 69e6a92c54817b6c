// Pictures and tables of a robot: the map over delay and gains, singular values, motions, joints.

import { draw, frame, line, table } from "./chart.js";
import { draggable } from "./dragging.js";
import { degrees } from "./words.js";

const MAP_HEIGHT = 430;
const HEIGHT = 300;
const STEP = 0.01;
const ROWS = 60;

/**
 * The map. `columns`: {delay [s], ranges} of `ranges`; `point` {delay, gain_scale}; `own`: the loop
 * as it was given.
 */
export function drawMap(svg, { window, columns, point, own }) {
  const ms = (x) => 1000 * x;
  const place = frame(svg, {
    x: { domain: window.delay.map(ms), log: false, label: "delay of the commands [ms]" },
    y: { domain: window.factor, log: true, label: "factor on all gains" },
    height: MAP_HEIGHT,
  });
  const [least, most] = window.factor;
  const clamp = (factor) => Math.min(Math.max(factor, least / 2), 2 * most);
  const at = (delay, factor) =>
    `${place.x(ms(delay)).toFixed(1)} ${place.y(clamp(factor)).toFixed(1)}`;
  const paths = { stable: "", "cell-limit-cycle": "", boundary: "" };
  for (let i = 0; i + 1 < columns.length; i++) {
    const [a, b] = [columns[i], columns[i + 1]];
    for (const kind of ["stable", "cell-limit-cycle"]) {
      const [left, right] = [a, b].map(({ ranges }) => joined(ranges, kind));
      const same = left.length === right.length;
      const middle = 0.5 * (a.delay + b.delay);
      const pieces = same
        ? left.map((one, k) => [a.delay, one, b.delay, right[k]])
        : [
            ...left.map((one) => [a.delay, one, middle, one]),
            ...right.map((one) => [middle, one, b.delay, one]),
          ];
      for (const [from, [low, high], to, [low2, high2]] of pieces) {
        const [top, bottom] = [`${at(from, high)}L${at(to, high2)}`, `${at(from, low)}L${at(to, low2)}`];
        paths[kind] += `M${top}L${at(to, low2)}L${at(from, low)}Z`;
        if (high < Infinity && high2 < Infinity) paths.boundary += `M${top}`;
        if (low > 0 && low2 > 0) paths.boundary += `M${bottom}`;
      }
    }
  }
  for (const [name, d] of Object.entries(paths)) place.inside.append(draw("path", { class: name, d }));
  const given = [place.x(ms(Math.min(...own.drives.delay))), place.y(1)];
  const [x, y] = [place.x(ms(point.delay)), place.y(point.gain_scale)];
  place.inside.append(
    draw("path", { class: "mark", d: `M${given[0] - 6} ${given[1]}l6 -6l6 6l-6 6Z` }),
    draw("line", { class: "hair", x1: x, x2: x, y1: place.top, y2: place.bottom }),
    draw("line", { class: "hair", x1: place.left, x2: place.right, y1: y, y2: y }),
    draw("circle", { class: "point", cx: x, cy: y, r: 7 }),
  );
  return place;
}

/** Neighbouring ranges of a kind as one: [[low, high]]. */
function joined(ranges, kind) {
  const found = [];
  for (const { low, high, unstable, shaking } of ranges) {
    const own = unstable === 0 ? "stable" : shaking <= 0 ? "cell-limit-cycle" : "";
    if (own !== kind) continue;
    const last = found[found.length - 1];
    if (last && last[1] === low) last[1] = high;
    else found.push([low, high]);
  }
  return found;
}

/** The map as a table. */
export function mapTable(columns) {
  const rows = columns.flatMap(({ delay, ranges }) =>
    ["stable", "cell-limit-cycle"].flatMap((kind) =>
      joined(ranges, kind).map(([low, high]) => ({ delay, low, high, kind })),
    ),
  );
  const column = (head, value) => ({ head, values: rows.map(value) });
  return table("Which gains are stable", [
    column("delay of the commands [ms]", ({ delay }) => 1000 * delay),
    column("gains from ×", ({ low }) => low),
    column("to ×", ({ high }) => high),
    column("the robot", ({ kind }) => (kind === "stable" ? "is stable" : "topples, does not shake")),
  ]);
}

/** Let delay and factor follow pointer and arrow keys. */
export function movable(pad, svg, now, moved) {
  const clamp = (value, [low, high]) => Math.min(Math.max(value, low), high);
  const go = (delay, factor) => {
    const { window } = now();
    moved(clamp(delay, window.delay), clamp(factor, window.factor));
  };
  draggable(pad, svg, (x, y) => {
    const [ms, factor] = now().place.invert(x, y);
    go(ms / 1000, factor);
  });
  pad.addEventListener("keydown", (event) => {
    const across = { ArrowLeft: -1, ArrowRight: 1 }[event.key] ?? 0;
    const up = { ArrowDown: -1, ArrowUp: 1 }[event.key] ?? 0;
    if (!across && !up) return;
    event.preventDefault();
    const by = STEP * (event.shiftKey ? 10 : 1);
    const { window, state } = now();
    const [low, high] = window.factor;
    go(state.delay + across * by * window.delay[1], state.gain_scale * (high / low) ** (up * by));
  });
}

/** Largest singular values of S and T; `points` of `withSensitivities`. */
export function drawSensitivities(svg, points, period) {
  const w = points.map(({ t }) => t / period);
  const S = points.map(({ peaks }) => peaks[0]);
  const T = points.map(({ peaks }) => peaks[1]);
  const top = Math.min(Math.max(...S, ...T, 1.2) * 1.3, 1e3);
  const low = Math.max(w[0], w[w.length - 1] / 1e5);
  const place = frame(svg, {
    x: { domain: [low, w[w.length - 1]], log: true, label: "frequency [rad/s]" },
    y: { domain: [0.05, top], log: true, label: "largest singular value" },
    height: HEIGHT,
  });
  line(place, [low, w[w.length - 1]], [1, 1], { class: "reference" });
  line(place, w, S, { class: "continuous" });
  line(place, w, T, { class: "sampled" });
}

/** The same as a table. */
export function sensitivityTable(points, period) {
  const stride = Math.max(1, Math.ceil(points.length / ROWS));
  const kept = points.filter((_, i) => i % stride === 0);
  const column = (head, value) => ({ head, values: kept.map(value) });
  return table("Largest singular values", [
    column("frequency [rad/s]", ({ t }) => t / period),
    column("S", ({ peaks }) => peaks[0]),
    column("T", ({ peaks }) => peaks[1]),
  ]);
}

/** How far, and in which phase, every joint moves in a motion: bars, and a hand for the phase. */
export function drawShape(svg, names, shape) {
  const width = Math.max(svg.parentElement.clientWidth, 240);
  const row = 22;
  const [left, right] = [Math.min(170, 0.4 * width), width - 34];
  svg.setAttribute("viewBox", `0 0 ${width} ${names.length * row + 8}`);
  const order = names.map((_, i) => i);
  if (shape) order.sort((a, b) => shape[b].share - shape[a].share);
  const parts = [];
  order.forEach((joint, i) => {
    const y = i * row + 4;
    const text = { class: "tick", x: left - 6, y: y + 14, "text-anchor": "end" };
    parts.push(draw("text", text, clipped(names[joint], left / 7)));
    if (!shape) return;
    const { amplitude, phase } = shape[joint];
    const length = Math.max(amplitude * (right - left), 1);
    parts.push(draw("rect", { class: "bar", x: left, y: y + 3, width: length, height: row - 8 }));
    const [cx, cy, r] = [width - 16, y + row / 2 - 1, 8];
    parts.push(draw("circle", { class: "reference", cx, cy, r }));
    const hand = { x1: cx, y1: cy, x2: cx + r * Math.cos(phase), y2: cy - r * Math.sin(phase) };
    if (amplitude > 0.01) parts.push(draw("line", { class: "hand", ...hand }));
  });
  svg.replaceChildren(...parts);
}

const clipped = (text, most) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);

/** The motion as a table. */
export function shapeTable(names, shape) {
  const rows = names.map((name, i) => ({ name, ...(shape?.[i] ?? {}) }));
  const column = (head, value) => ({ head, values: rows.map(value) });
  return table("How the joints move", [
    column("joint", ({ name }) => name),
    column("amplitude, of the largest", ({ amplitude }) => amplitude ?? NaN),
    column("phase [°]", ({ phase }) => degrees(phase ?? NaN)),
    column("share of the energy [%]", ({ share }) => percent(share ?? NaN)),
  ]);
}

/** Rows {name, label, text, value} of the margins of all joints at once; no value is one that is not there yet. */
export function showMargins(body, rows) {
  body.replaceChildren(
    ...rows.map(({ name, label, text, value }) => {
      const made = document.createElement("tr");
      made.dataset.name = name;
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = label;
      made.append(head);
      const cell = made.insertCell();
      if (value !== undefined) cell.dataset.value = String(value);
      cell.textContent = text;
      return made;
    }),
  );
}

/** While something moves, no number of before is left. */
export function waiting(body) {
  for (const cell of body.querySelectorAll("td")) {
    cell.textContent = "…";
    delete cell.dataset.value;
    delete cell.parentElement.dataset.margins;
  }
}

/** Shares in per cent; what is rounding is none. */
const percent = (share) => (share < 1e-6 ? 0 : 100 * share);

/** Every joint with all others closed, the one that shakes first at the top. */
export function jointTable({ joints: names, rotary }, drives, joints, shape) {
  const units = [true, false].filter((kind) => rotary.includes(kind));
  const per = (hinge, slide) => units.map((kind) => (kind ? hinge : slide)).join(" or ");
  const order = names.map((_, i) => i);
  const rank = shape ? (i) => -shape[i].share : (i) => joints[i]?.disk_margin ?? i;
  order.sort((a, b) => rank(a) - rank(b));
  const own = (name) => order.map((i) => joints[i]?.[name] ?? NaN);
  const columns = [
    ["joint", order.map((i) => names[i])],
    [`kp [${per("N m/rad", "N/m")}]`, order.map((i) => drives.kp[i])],
    [`kd [${per("N m s/rad", "N s/m")}]`, order.map((i) => drives.kd[i])],
    ["disk margin", own("disk_margin")],
    ["Ms", own("sensitivity_peak")],
    ["Mt", own("complementary_peak")],
    ["gain margin", own("gain_margin")],
    ["down to", own("gain_reduction_margin")],
    ["phase [°]", own("phase_margin").map(degrees)],
    ["delay [ms]", own("delay_margin").map((x) => 1000 * x)],
    ["shakes [%]", order.map((i) => (shape ? percent(shape[i].share) : NaN))],
  ];
  const caption = "Each joint with all others closed, the one that shakes first at the top";
  const made = table(
    caption,
    columns.map(([head, values]) => ({ head, values })),
  );
  order.forEach((joint, i) => {
    const row = made.tBodies[0].rows[i];
    row.dataset.joint = names[joint];
    row.dataset.margins = JSON.stringify(joints[joint] ?? {}, (_, x) => (x === Infinity ? "inf" : x));
  });
  return made;
}
