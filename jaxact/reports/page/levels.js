// Level lines of a margin over the gains: on a grid, from the responses at cached frequencies.

import { unstableRoots } from "./roots.js";

/** Margins that lines are drawn of: name, unit, levels, and how a level reads as the value of the
 * field, which is 0 on the boundary. */
export const QUANTITIES = {
  sensitivity_peak: {
    label: "Ms",
    levels: [1.2, 1.4, 1.6, 2, 3, 5],
    text: (x) => `${x}`,
    field: (x) => 1 / x,
  },
  gain_margin: {
    label: "gain margin",
    levels: [1.5, 2, 3, 5, 10],
    text: (x) => `×${x}`,
    field: Math.log,
  },
  phase_margin: {
    label: "phase margin",
    levels: [10, 20, 30, 45, 60],
    text: (x) => `${x}°`,
    field: (x) => (x * Math.PI) / 180,
  },
  delay_margin: {
    label: "delay margin",
    levels: [0.5, 1, 2, 5, 10, 20, 50],
    text: (x) => `${x} ms`,
    field: (x) => x / 1000,
  },
};

/**
 * Values over `count` x `count` gains of a window, row by row of kd: of the quantity, 0 if unstable,
 * and min |1 + L|, negative if unstable.
 */
export function fields(loop, cached, window, quantity, count) {
  const values = new Float64Array(count * count);
  const distance = new Float64Array(count * count);
  const [kps, kds] = [window.kp, window.kd].map(([low, high]) =>
    Array.from({ length: count }, (_, i) => low * (high / low) ** (i / (count - 1))),
  );
  kds.forEach((kd, row) =>
    kps.forEach((kp, column) => {
      const at = row * count + column;
      const stable = unstableRoots(loop, cached, kp, kd) === 0;
      const near = modulus(cached, kp, kd);
      distance[at] = stable ? near : -near;
      if (!stable) return;
      values[at] = quantity === "sensitivity_peak" ? near : crossings(cached, kp, kd, quantity, loop.sampled);
    }),
  );
  return { values, distance };
}

/** min |Delta| / |A| = 1 / Ms over the frequencies. */
function modulus({ w, ar, ai, br, bi, cr, ci }, kp, kd) {
  let least = 1;
  for (let i = 0; i < w.length; i++) {
    const re = ar[i] + kp * br[i] + kd * cr[i];
    const im = ai[i] + kp * bi[i] + kd * ci[i];
    const size = ar[i] * ar[i] + ai[i] * ai[i];
    const square = (re * re + im * im) / size;
    if (square < least) least = square;
  }
  return Math.sqrt(least);
}

/** ln of the gain margin, the phase margin [rad] or the delay margin [s], between frequencies. */
function crossings({ w, ar, ai, br, bi, cr, ci }, kp, kd, quantity, sampled) {
  let least = quantity === "phase_margin" ? Math.PI : 1e3;
  let [before, beforeRe, beforeIm] = [0, 0, 0];
  for (let i = 0; i < w.length; i++) {
    const nr = kp * br[i] + kd * cr[i];
    const ni = kp * bi[i] + kd * ci[i];
    const size = ar[i] * ar[i] + ai[i] * ai[i];
    // -L, and |L|^2 - 1
    const re = -(nr * ar[i] + ni * ai[i]) / size;
    const im = -(ni * ar[i] - nr * ai[i]) / size;
    const excess = (nr * nr + ni * ni) / size - 1;
    if (i > 0 && quantity === "gain_margin") {
      if (beforeIm > 0 !== im > 0) {
        const part = beforeIm / (beforeIm - im);
        least = Math.min(least, logFactor(beforeRe + part * (re - beforeRe)));
      }
    } else if (i > 0 && before > 0 !== excess > 0) {
      const part = before / (before - excess);
      const [y, x] = [beforeIm + part * (im - beforeIm), beforeRe + part * (re - beforeRe)];
      let angle = Math.atan2(y, x);
      if (quantity === "delay_margin") {
        if (angle < 0) angle += 2 * Math.PI;
        angle /= w[i - 1] + part * (w[i] - w[i - 1]);
      }
      least = Math.min(least, Math.abs(angle));
    }
    [before, beforeRe, beforeIm] = [excess, re, im];
  }
  // At the last frequency, z = -1, a sampled loop is real.
  if (sampled && quantity === "gain_margin") least = Math.min(least, logFactor(beforeRe));
  return least;
}

/** ln of the factor above 1 that takes -L, real there, to 1; Infinity where none does. */
const logFactor = (there) => (there > 0 && there < 1 ? -Math.log(there) : Infinity);

/**
 * Segments [x0, y0, x1, y1] of a level line, in cells of the grid (marching squares).
 */
export function levelLine(values, count, level) {
  const found = [];
  const at = (row, column) => values[row * count + column];
  for (let row = 0; row + 1 < count; row++) {
    for (let column = 0; column + 1 < count; column++) {
      const corners = [
        [column, row],
        [column + 1, row],
        [column + 1, row + 1],
        [column, row + 1],
      ];
      const heights = corners.map(([x, y]) => at(y, x) - level);
      const cuts = [];
      for (let side = 0; side < 4; side++) {
        const [a, b] = [heights[side], heights[(side + 1) % 4]];
        if (a > 0 === b > 0) continue;
        const part = a / (a - b);
        const [from, to] = [corners[side], corners[(side + 1) % 4]];
        cuts.push([from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])]);
      }
      for (let i = 0; i + 1 < cuts.length; i += 2) found.push([...cuts[i], ...cuts[i + 1]]);
    }
  }
  return found;
}

/** Polygons [x, y, x, y, ...] of where the values are above 0, a cell each. */
export function regionAbove(values, count) {
  const found = [];
  for (let row = 0; row + 1 < count; row++) {
    for (let column = 0; column + 1 < count; column++) {
      const corners = [
        [column, row],
        [column + 1, row],
        [column + 1, row + 1],
        [column, row + 1],
      ];
      const heights = corners.map(([x, y]) => values[y * count + x]);
      const polygon = [];
      for (let side = 0; side < 4; side++) {
        const [a, b] = [heights[side], heights[(side + 1) % 4]];
        const [from, to] = [corners[side], corners[(side + 1) % 4]];
        if (a > 0) polygon.push(...from);
        if (a > 0 === b > 0) continue;
        const part = a / (a - b);
        polygon.push(from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1]));
      }
      if (polygon.length) found.push(polygon);
    }
  }
  return found;
}
