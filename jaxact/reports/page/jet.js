// Complex numbers with their derivative: (re + j im) and d/ds of it, by the rules of calculus.

/** A value with its derivative by s; a constant has none. */
export const jet = (re, im = 0, dre = 0, dim = 0) => ({ re, im, dre, dim });

export const plus = (a, b) => jet(a.re + b.re, a.im + b.im, a.dre + b.dre, a.dim + b.dim);

export const scaled = (a, x) => jet(a.re * x, a.im * x, a.dre * x, a.dim * x);

export const times = (a, b) =>
  jet(
    a.re * b.re - a.im * b.im,
    a.re * b.im + a.im * b.re,
    a.dre * b.re - a.dim * b.im + a.re * b.dre - a.im * b.dim,
    a.dre * b.im + a.dim * b.re + a.re * b.dim + a.im * b.dre,
  );

/** exp(a). */
export function exponential(a) {
  const size = Math.exp(a.re);
  const re = size * Math.cos(a.im);
  const im = size * Math.sin(a.im);
  return jet(re, im, re * a.dre - im * a.dim, re * a.dim + im * a.dre);
}

/** 1 - exp(a), which does not cancel for small a. */
export function oneLessExponential(a) {
  const half = Math.sin(0.5 * a.im);
  const whole = exponential(a);
  const re = 2 * half * half - Math.expm1(a.re) * Math.cos(a.im);
  return jet(re, -whole.im, -whole.dre, -whole.dim);
}

/** sum_i coefficients[i] a^i with real coefficients, by Horner's rule. */
export function polynomial(coefficients, a) {
  let total = jet(coefficients[coefficients.length - 1]);
  for (let i = coefficients.length - 2; i >= 0; i--) {
    total = times(total, a);
    total.re += coefficients[i];
  }
  return total;
}
