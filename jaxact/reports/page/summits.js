// The highest points of a curve over w T.

const PEAKS = 3;
const GOLDEN = 0.5 * (3 - Math.sqrt(5));

/** The largest value of a curve over w T, refined near its highest points on the grid: {t, value}; in steps. */
export function* highest(points, value, exact) {
  const heights = points.map(value);
  let best = { t: points[0].t, value: -Infinity };
  const tops = heights
    .map((height, i) => ({ height, i }))
    .filter(({ height, i }) => !(heights[i - 1] > height) && !(heights[i + 1] > height))
    .sort((a, b) => b.height - a.height)
    .slice(0, PEAKS)
    .filter(({ height }, _, all) => height > 0.9 * all[0].height);
  for (const { i } of tops) {
    const [low, middle, high] = [Math.max(i - 1, 0), i, Math.min(i + 1, points.length - 1)];
    const ends = [points[low].t, points[middle].t, points[high].t];
    const found = yield* summit(function* (t) {
      return exact(t);
    }, ...ends);
    if (found.value > best.value) best = found;
    yield;
  }
  return best;
}

/**
 * The maximum {t, value} of f between low and high, beside a point inside, by Brent's method; f and
 * it are in steps. It is found where two parabolas running rise by less than a share `flat`.
 */
export function* summit(f, low, inside, high, flat = 0) {
  let [a, b, x, w, v] = [low, high, inside, inside, inside];
  let [fx, fw, fv] = [yield* f(x), -Infinity, -Infinity];
  let calm = 0;
  [fw, fv] = [fx, fx];
  let [d, e] = [0, 0];
  for (let i = 0; i < 60; i++) {
    const middle = 0.5 * (a + b);
    const near = 1e-9 * Math.abs(x) + 1e-13;
    if (Math.abs(x - middle) <= 2 * near - 0.5 * (b - a)) break;
    let parabolic = false;
    if (Math.abs(e) > near) {
      const [r, q] = [(x - w) * (fx - fv), (x - v) * (fx - fw)];
      const p = (x - v) * q - (x - w) * r;
      const u = 2 * (q - r);
      const step = -p / u;
      if (Math.abs(step) < Math.abs(0.5 * e) && x + step > a && x + step < b) {
        [e, d, parabolic] = [d, step, true];
      }
    }
    if (!parabolic) {
      e = x < middle ? b - x : a - x;
      d = GOLDEN * e;
    }
    const u = Math.abs(d) >= near ? x + d : x + Math.sign(d) * near;
    const fu = yield* f(u);
    calm = parabolic && Math.abs(fu - fx) < flat * fx ? calm + 1 : 0;
    if (fu >= fx) {
      if (u >= x) a = x;
      else b = x;
      [v, fv, w, fw, x, fx] = [w, fw, x, fx, u, fu];
    } else {
      if (u < x) a = u;
      else b = u;
      if (fu >= fw || w === x) [v, fv, w, fw] = [w, fw, u, fu];
      else if (fu >= fv || v === x || v === w) [v, fv] = [u, fu];
    }
    if (calm > 1) break;
  }
  return { t: x, value: fx };
}

