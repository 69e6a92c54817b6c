// The simulated cells of a sweep, beneath the exact boundary.

import { draw, short } from "./chart.js";

export const VERDICTS = ["stable", "limit cycle", "unstable", "invalid", "topples"];
const classOf = (code) => `cell-${VERDICTS[code].replace(" ", "-")}`;

/** The edges of cells around rising values, halfway on a logarithmic axis. */
export function edgesOf(values) {
  const inner = values.slice(1).map((x, i) => Math.sqrt(x * values[i]));
  const first = values.length > 1 ? (values[0] * values[0]) / inner[0] : values[0] / 1.1;
  const last = values[values.length - 1];
  return [first, ...inner, values.length > 1 ? (last * last) / inner[inner.length - 1] : last * 1.1];
}

/** Draw the cells of one loop into a frame: a path for each verdict, of runs along kp. */
export function drawCells(place, { kp, kd, scale, verdicts }, loop) {
  const xs = edgesOf(kp).map((x) => place.x(scale[loop] * x));
  const ys = edgesOf(kd).map((y) => place.y(scale[loop] * y));
  const paths = {};
  const codes = verdicts[loop];
  for (let row = 0; row < kd.length; row++) {
    let from = 0;
    for (let column = 1; column <= kp.length; column++) {
      const code = codes[row * kp.length + from];
      if (column < kp.length && codes[row * kp.length + column] === code) continue;
      const [x0, x1, y0, y1] = [xs[from], xs[column], ys[row], ys[row + 1]].map((x) => x.toFixed(1));
      if (code !== "-") paths[code] = `${paths[code] ?? ""}M${x0} ${y0}H${x1}V${y1}H${x0}Z`;
      from = column;
    }
  }
  for (const [code, d] of Object.entries(paths)) {
    place.inside.append(draw("path", { class: `cell ${classOf(code)}`, d }));
  }
}

const nearest = (values, x) =>
  values.reduce((best, value, i) => {
    const distance = (at) => Math.abs(Math.log(values[at] / x));
    return distance(i) < distance(best) ? i : best;
  }, 0);

/** The cell that is nearest to a point: {kp, kd, near, verdict, growth, amplitude, frequency}. */
export function cellAt({ kp, kd, scale, near, verdicts, ...numbers }, loop, point) {
  const factor = scale[loop];
  const [column, row] = [nearest(kp, point.kp / factor), nearest(kd, point.kd / factor)];
  const at = row * kp.length + column;
  const code = verdicts[loop][at];
  const verdict = code === "-" ? null : VERDICTS[code];
  const found = { kp: factor * kp[column], kd: factor * kd[row], near, verdict };
  for (const [name, values] of Object.entries(numbers)) found[name] = values[loop][at];
  return found;
}

/** What was simulated in a cell, in words. */
export function cellWords({ kp, kd, near, verdict, growth_rate, limit_cycle_amplitude, limit_cycle_frequency }, unit) {
  const there = near
    ? `Simulated nearest to kp ${short(kp)}, kd ${short(kd)}:`
    : `Simulated at kp ${short(kp)}, kd ${short(kd)}, the nearest cell:`;
  if (verdict === null) return `${there} not yet.`;
  const grows =
    growth_rate === null ? "" : `; growth rate ${short(growth_rate, 3)} 1/s`;
  const cycle =
    verdict === "limit cycle"
      ? ` of ${short(limit_cycle_amplitude ?? NaN, 3)} ${unit} at ${short(limit_cycle_frequency ?? NaN, 3)} rad/s`
      : "";
  return `${there} ${verdict}${cycle}${grows}.`;
}

/** The verdicts that a loop has, for the key: [{text, kind}]. */
export const cellKey = ({ verdicts }, loop) =>
  [...new Set(verdicts[loop])]
    .filter((code) => code !== "-")
    .sort()
    .map((code) => ({ text: VERDICTS[code], kind: classOf(code) }));
