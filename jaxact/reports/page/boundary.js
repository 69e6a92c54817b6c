// The exact stability boundary in the plane of the gains: where Delta(jw) = 0,
//
//   kp Re B + kd Re C = -Re A,    kp Im B + kd Im C = -Im A,
//
// and the lines of a real root: kp = -k at rest, and z = -1 of the sampled loop.

import { unstableRoots } from "./roots.js";

const LONGEST = 0.01;
const DEEPEST = 12;
const ASIDE = 1e-3;
const ON_LINE = 120;

/** The gains [kp, kd] with a root at jw. */
export function marginalGains(loop, w) {
  const { A, B, C } = loop.parts(0, w);
  const determinant = B.re * C.im - B.im * C.re;
  return [(A.im * C.re - A.re * C.im) / determinant, (A.re * B.im - A.im * B.re) / determinant];
}

/** Places in the picture, 0 to 1 along axes that are logarithmic. */
const place = (value, [low, high]) => Math.log(value / low) / Math.log(high / low);

/**
 * Curves of marginal gains in a window, cut where they cease to bound the stable region.
 *
 * cached: of `responses` over the frequencies. Returns [{kp, kd, w, separates}] with arrays.
 */
export function boundary(loop, cached, window) {
  const lines = [traced(loop, cached.w, window)];
  lines.push(...realRoots(loop, window));
  return lines.flatMap((points) => byRole(loop, cached, window, points));
}

/** Points of the curve, close to each other wherever it passes the window. */
function traced(loop, frequencies, window) {
  const at = (w) => {
    const [kp, kd] = marginalGains(loop, w);
    const there = { w, kp, kd, x: place(kp, window.kp), y: place(kd, window.kd) };
    return there.kp > 0 && there.kd > 0 ? there : { ...there, x: NaN, y: NaN };
  };
  const found = [];
  const add = (a, b, depth) => {
    const far = Math.hypot(b.x - a.x, b.y - a.y);
    const apart = Number.isNaN(far) ? Number.isNaN(a.x) !== Number.isNaN(b.x) : far > LONGEST;
    if (apart && depth < DEEPEST && (near(a) || near(b))) {
      const middle = at(0.5 * (a.w + b.w));
      add(a, middle, depth + 1);
      add(middle, b, depth + 1);
    } else found.push(b);
  };
  let before = at(frequencies[0]);
  found.push(before);
  for (let i = 1; i < frequencies.length; i++) {
    const next = at(frequencies[i]);
    add(before, next, 0);
    before = next;
  }
  return found;
}

const near = ({ x, y }) => x > -0.1 && x < 1.1 && y > -0.1 && y < 1.1;

/** Points of the lines of a root at rest and, of the sampled loop, at the Nyquist frequency. */
function realRoots(loop, window) {
  const along = ([low, high]) =>
    Array.from({ length: ON_LINE + 1 }, (_, i) => low * (high / low) ** (i / ON_LINE));
  const point = (w, kp, kd) => ({ w, kp, kd, x: place(kp, window.kp), y: place(kd, window.kd) });
  const stiffness = -loop.parameters.joint_stiffness;
  const lines = [along(window.kd).map((kd) => point(0, stiffness, kd))];
  if (loop.sampled) {
    const { A, B, C } = loop.parts(0, loop.end);
    const byKp = along(window.kp).map((kp) => point(loop.end, kp, -(A.re + kp * B.re) / C.re));
    const byKd = along(window.kd).map((kd) => point(loop.end, -(A.re + kd * C.re) / B.re, kd));
    lines.push([...byKp, ...byKd].filter(near).sort((a, b) => a.x - b.x || a.y - b.y));
  }
  return lines;
}

/** Stretches inside the window that separate stable gains from others, and those that do not. */
function byRole(loop, cached, window, points) {
  const found = [];
  let open = null;
  points.forEach((point, i) => {
    const next = points[i + 1];
    if (!near(point) || next === undefined || !near(next)) {
      open = null;
      return;
    }
    const separates = isEdge(loop, cached, window, point, next);
    if (open === null || open.separates !== separates) {
      open = { separates, kp: [point.kp], kd: [point.kd], w: [point.w] };
      found.push(open);
    }
    open.kp.push(next.kp);
    open.kd.push(next.kd);
    open.w.push(next.w);
  });
  return found;
}

/** Whether beside the middle of two points one side is stable and the other is not. */
function isEdge(loop, cached, window, a, b) {
  const length = Math.hypot(b.x - a.x, b.y - a.y);
  if (!(length > 0)) return false;
  const [dx, dy] = [(-ASIDE * (b.y - a.y)) / length, (ASIDE * (b.x - a.x)) / length];
  const count = (sign) => {
    const x = 0.5 * (a.x + b.x) + sign * dx;
    const y = 0.5 * (a.y + b.y) + sign * dy;
    const kp = window.kp[0] * (window.kp[1] / window.kp[0]) ** x;
    const kd = window.kd[0] * (window.kd[1] / window.kd[0]) ** y;
    return unstableRoots(loop, cached, kp, kd);
  };
  return (count(1) === 0) !== (count(-1) === 0);
}
