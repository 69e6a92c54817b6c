// Frequencies at which a loop is looked at, and its A, B and C there.

const PER_DECADE = 45;
const PER_LOBE = 24;
const MOST_IN_LOBES = 3000;
// Around a resonance, in units of its half width; not on it, where an undamped joint has none.
const AROUND = [-8, -4, -2, -1, -0.5, -0.2, 0.02, 0.2, 0.5, 1, 2, 4, 8];

/**
 * Frequencies [rad/s], ascending: dense in the logarithm, in the phase of the delay, and around
 * resonances. From below all corners of every loop of the window to beyond their crossovers.
 *
 * window: {kp: [low, high], kd: [low, high]} of the gains, low > 0.
 */
export function frequencyGrid(loop, window) {
  const { mass, wn, zeta, joint_damping: c, joint_stiffness: k } = loop.parameters;
  const [kpLow, kpHigh] = window.kp;
  const [kdLow, kdHigh] = window.kd;
  const rigid = Math.sqrt((kpHigh + Math.abs(k)) / mass);
  const fast = 2 * Math.max(rigid, (kdHigh + c) / mass, kpHigh / kdHigh);
  const slow = [Math.sqrt(kpLow / mass), kpLow / (kdHigh + c), kpLow / kdHigh];
  if (k !== 0) slow.push(Math.sqrt(Math.abs(k) / mass), Math.abs(k) / (kdHigh + c));
  const found = [];
  let high = Math.max(10 * fast, wn < Infinity ? 4 * wn * Math.max(1, zeta) : 0);
  if (loop.lag > 0) high = Math.max(high, 30 / loop.lag);
  if (loop.parameters.velocity_filter < Infinity) {
    high = Math.max(high, 4 * loop.parameters.velocity_filter);
  }
  if (loop.sampled) high = loop.end;
  const low = Math.min(1e-2 * Math.min(...slow), 1e-3 * high);
  const number = Math.ceil(PER_DECADE * Math.log10(high / low));
  for (let i = 0; i <= number; i++) found.push(low * (high / low) ** (i / number));
  found[number] = high;
  if (loop.lag > 0) {
    const turns = Math.min(high, Math.max(fast, 30 / loop.lag));
    const step = Math.max((2 * Math.PI) / (PER_LOBE * loop.lag), turns / MOST_IN_LOBES);
    for (let w = step; w < turns; w += step) found.push(w);
  }
  if (wn < Infinity && zeta < 1) found.push(...AROUND.map((x) => wn * (1 + zeta * x)));
  if (k > 0) {
    const own = Math.sqrt(k / mass);
    const width = Math.min(Math.max(c / (2 * mass), 1e-4 * own), 0.1 * own);
    found.push(...AROUND.map((x) => own + width * x));
  }
  const inside = found.filter((w) => w >= low && w <= high).sort((a, b) => a - b);
  return Float64Array.from(inside.filter((w, i) => i === 0 || w > inside[i - 1]));
}

/** A, B and C on the imaginary axis: an array for each of their real and imaginary parts. */
export function responses(loop, grid) {
  const names = ["ar", "ai", "br", "bi", "cr", "ci"];
  const found = Object.fromEntries(names.map((name) => [name, new Float64Array(grid.length)]));
  grid.forEach((w, i) => {
    const { A, B, C } = loop.parts(0, w);
    [A.re, A.im, B.re, B.im, C.re, C.im].forEach((x, j) => (found[names[j]][i] = x));
  });
  return { w: grid, ...found };
}

/** L(jw) and dL/dw, S and T by them: {re, im, dre, dim} of L = (kp B + kd C) / A. */
export function openLoop(loop, kp, kd, w) {
  const { A, B, C } = loop.parts(0, w);
  const re = kp * B.re + kd * C.re;
  const im = kp * B.im + kd * C.im;
  const size = A.re * A.re + A.im * A.im;
  const lr = (re * A.re + im * A.im) / size;
  const li = (im * A.re - re * A.im) / size;
  // L' = (N' - L A') / A by s, times j by w.
  const nr = kp * B.dre + kd * C.dre - (lr * A.dre - li * A.dim);
  const ni = kp * B.dim + kd * C.dim - (lr * A.dim + li * A.dre);
  const sr = (nr * A.re + ni * A.im) / size;
  const si = (ni * A.re - nr * A.im) / size;
  return { re: lr, im: li, dre: -si, dim: sr };
}
