// A log over its simulation: what is seen of it follows two sliders, or a drag across a picture.

import { fill, frame, line, lines, short, table } from "./chart.js";

const STEPS = 1000;
const ROWS = 60;
// The shortest window, as a share of the log.
const SHORTEST = 1e-3;
const DRAGGED = 4; // pixels: less is a click

/** The first and the last number of rising values within a window, and one more to either side. */
export function within(values, [from, to]) {
  const first = values.findIndex((x) => x >= from);
  const after = values.findIndex((x) => x > to);
  const last = after < 0 ? values.length - 1 : after;
  return [Math.max((first < 0 ? values.length : first) - 1, 0), last];
}

/** The least and the largest of some values, a little apart. */
export function spanOf(values) {
  const [low, high] = values.reduce(([a, b], x) => [Math.min(a, x), Math.max(b, x)], [
    Infinity,
    -Infinity,
  ]);
  const more = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
  return [low - more, high + more];
}

/** The view; `by` gives an element by its id. `show(drive)` shows a drive's logs, then `redraw()`. */
export function logView(by) {
  let drive = null;
  let log = null;
  let seen = [0, 1];
  let place = null;

  const end = () => log.time[log.time.length - 1];

  function show(other) {
    drive = other;
    by("log").replaceChildren(
      ...drive.logs.map(({ title, role }, i) => new Option(`${title} (${role})`, i)),
    );
    by("log").value = drive.logs.length - 1;
    take();
  }

  function take() {
    log = drive.logs[by("log").value];
    lines(by("log-notes"), log.says);
    look(0, end());
  }

  /** Look at a window of the log [s], the sliders with it. */
  function look(from, to) {
    const length = Math.min(Math.max(to - from, SHORTEST * end()), end());
    const start = Math.min(Math.max(from, 0), end() - length);
    seen = [start, start + length];
    const places = [
      [by("log-from"), start / end(), start],
      [by("log-length"), 1 + Math.log(length / end()) / Math.log(1 / SHORTEST), length],
    ];
    for (const [slider, at, value] of places) {
      slider.value = Math.round(STEPS * at);
      slider.setAttribute("aria-valuetext", `${short(value)} s`);
    }
    redraw();
  }

  function redraw() {
    if (!log) return;
    const [first, last] = within(log.time, seen);
    const part = (values) => values.slice(first, last + 1);
    const [time, measured, simulated] = [log.time, log.measured, log.simulated].map(part);
    const rest = measured.map((x, i) => x - simulated[i]);
    const x = { domain: seen, log: false, label: "time [s]" };
    const label = `${drive.signal} [${drive.error_unit}]`;
    place = frame(by("log-over"), {
      x,
      y: { domain: spanOf([...measured, ...simulated]), log: false, label },
      height: 280,
    });
    line(place, time, measured, { class: "measured" });
    line(place, time, simulated, { class: "simulated" });
    const below = frame(by("log-rest"), {
      x,
      y: { domain: spanOf(rest), log: false, label: `residual [${drive.error_unit}]` },
      height: 180,
    });
    line(below, seen, [0, 0], { class: "reference" });
    line(below, time, rest, { class: "rest" });
    say(time, rest);
    fill(by("log-data"), () => [rowsOf(time, measured, simulated, rest)]);
  }

  function say(time, rest) {
    const unit = drive.error_unit;
    const inside = rest.filter((_, i) => time[i] >= seen[0] && time[i] <= seen[1]);
    const largest = inside.reduce((a, x) => Math.max(a, Math.abs(x)), 0);
    by("log-says").textContent =
      `${short(seen[0])} to ${short(seen[1])} s: the largest residual is ${short(largest, 3)} ${unit}; ` +
      `of the whole log, ${log.rows} rows, ${short(log.largest, 3)} ${unit} and rms ${short(log.rms, 3)} ${unit}.`;
  }

  function rowsOf(time, measured, simulated, rest) {
    const stride = Math.max(1, Math.ceil(time.length / ROWS));
    const every = (values) => values.filter((_, i) => i % stride === 0);
    return table(`${log.title}, every ${stride === 1 ? "row" : `${stride}th point drawn`}`, [
      { head: "time [s]", values: every(time) },
      { head: `measured [${drive.error_unit}]`, values: every(measured) },
      { head: `simulated [${drive.error_unit}]`, values: every(simulated) },
      { head: `residual [${drive.error_unit}]`, values: every(rest) },
    ]);
  }

  for (const id of ["log-over", "log-rest"]) brushed(by(id), () => place, look);
  by("log").addEventListener("change", take);
  by("log-whole").addEventListener("click", () => look(0, end()));
  by("log-from").addEventListener("input", () => {
    const from = (by("log-from").value / STEPS) * end();
    look(from, from + seen[1] - seen[0]);
  });
  by("log-length").addEventListener("input", () => {
    const length = end() * (1 / SHORTEST) ** (by("log-length").value / STEPS - 1);
    look(seen[0], seen[0] + length);
  });
  return { show, redraw };
}

/** Let a drag across a picture choose a window of its first axis. */
function brushed(svg, place, look) {
  let from = null;
  const at = (event) => {
    const box = svg.getBoundingClientRect();
    return ((event.clientX - box.left) * svg.viewBox.baseVal.width) / box.width;
  };
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    from = at(event);
  });
  svg.addEventListener("pointerup", (event) => {
    const ends = [from, at(event)].sort((a, b) => a - b);
    if (from !== null && ends[1] - ends[0] > DRAGGED) {
      look(...ends.map((x) => place().invert(x, 0)[0]));
    }
    from = null;
  });
}
