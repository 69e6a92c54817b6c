// Where a loop that depends on two real numbers, as on frequency and delay, is marginal: I + L singular.
//
//   w^H L v = -1 of the eigenvalue with the vectors v and w, by Newton's method over both numbers.
//
// The eigenvalue is followed by its vectors: legs that are alike have eigenvalues so near to each
// other that the nearest one may be another leg's.

import { adjoint, eigenvalues, inverse } from "./matrices.js";

// Eigenvalues further from -1 than this are not followed to it.
const AROUND = 0.5;
const STEPS = 20;
// Differences for slopes; a shift is off an eigenvalue by this share, so that nothing is singular.
const [SMALL, OFF] = [1e-6, 1e-10];
// How near to -1, and how small a step is the last, relative.
const CLOSE = 1e-12;

/**
 * Points {x, y} near a guess at which an eigenvalue of L is -1, each eigenvalue followed by itself.
 *
 * `at(x, y)` is L; `inside(x, y)` whether a point is one that is looked for.
 */
export function marginalPoints(at, [x, y], inside) {
  const L = at(x, y);
  return eigenvalues(L)
    .filter(({ re, im }) => Math.hypot(re + 1, im) < AROUND)
    .map((value) => newton(at, [x, y], L, value, inside))
    .filter((found) => found !== null);
}

function newton(at, [x, y], first, guess, inside) {
  let [L, value, both] = [first, guess, starting(first.n)];
  for (let i = 0; i < STEPS; i++) {
    // More often for vectors that are still anything.
    for (let k = i === 0 ? 3 : 1; k > 0; k--) {
      both = closer(L, value, both);
      value = quotientOf(L, both);
    }
    const [fr, fi] = [value.re + 1, value.im];
    if (Math.hypot(fr, fi) < CLOSE) return { x, y };
    const [dx, dy] = [SMALL * x, SMALL * (Math.abs(y) + 1e-3)];
    const [a, b] = [quotientOf(at(x + dx, y), both), quotientOf(at(x, y + dy), both)];
    const [ar, ai] = [(a.re - value.re) / dx, (a.im - value.im) / dx];
    const [br, bi] = [(b.re - value.re) / dy, (b.im - value.im) / dy];
    const det = ar * bi - ai * br;
    const step = [(fr * bi - fi * br) / det, (ar * fi - ai * fr) / det];
    [x, y] = [x - step[0], Math.max(y - step[1], 0)];
    if (!(x > 0 && x <= Math.PI && inside(x, y))) return null;
    if (Math.hypot(step[0] / x, step[1] / (y + 1e-3)) < CLOSE) return { x, y };
    L = at(x, y);
    value = quotientOf(L, both);
  }
  return null;
}

const starting = (n) => {
  const any = (a) => ({
    re: Float64Array.from({ length: n }, (_, i) => 1 + 0.3 * Math.cos(a * i + 1)),
    im: Float64Array.from({ length: n }, (_, i) => 0.3 * Math.sin(a * i * i + 2)),
  });
  return { right: any(7), left: any(5) };
};

/** Vectors {right, left} one step of inverse iteration nearer to those of the eigenvalue at a value. */
function closer(L, { re, im }, { right, left }) {
  const n = L.n;
  const less = { n, re: L.re.slice(), im: L.im.slice() };
  const off = OFF * Math.max(Math.hypot(re, im), 1e-3);
  for (let i = 0; i < n; i++) {
    less.re[i * (n + 1)] -= re + off;
    less.im[i * (n + 1)] -= im;
  }
  const Z = inverse(less);
  return { right: unit(applied(Z, right)), left: unit(applied(adjoint(Z), left)) };
}

/** w^H L v / w^H v. */
function quotientOf(L, { right, left }) {
  const [above, below] = [inner(left, applied(L, right)), inner(left, right)];
  const size = below.re * below.re + below.im * below.im;
  return {
    re: (above.re * below.re + above.im * below.im) / size,
    im: (above.im * below.re - above.re * below.im) / size,
  };
}

function applied({ n, re: ar, im: ai }, { re: xr, im: xi }) {
  const [re, im] = [new Float64Array(n), new Float64Array(n)];
  for (let i = 0, k = 0; i < n; i++) {
    for (let j = 0; j < n; j++, k++) {
      re[i] += ar[k] * xr[j] - ai[k] * xi[j];
      im[i] += ar[k] * xi[j] + ai[k] * xr[j];
    }
  }
  return { re, im };
}

/** w^H v. */
function inner(w, v) {
  let [re, im] = [0, 0];
  for (let i = 0; i < v.re.length; i++) {
    re += w.re[i] * v.re[i] + w.im[i] * v.im[i];
    im += w.re[i] * v.im[i] - w.im[i] * v.re[i];
  }
  return { re, im };
}

function unit({ re, im }) {
  let square = 0;
  for (let i = 0; i < re.length; i++) square += re[i] * re[i] + im[i] * im[i];
  const size = Math.sqrt(square);
  return { re: re.map((x) => x / size), im: im.map((x) => x / size) };
}
