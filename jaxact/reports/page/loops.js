// The loop of one joint as a characteristic function that is affine in the gains,
//
//   Delta(s) = A(s) + kp B(s) + kd C(s),    L = (kp B + kd C) / A,    S = A / Delta,
//
// in continuous time and as the controller samples it. All analysis works on A, B and C alone.

import { exponential, jet, oneLessExponential, plus, polynomial, scaled, times } from "./jet.js";
import { advanced, applied, transition } from "./transition.js";

/** The delay within the loop [s]: of command, measurement and output together. */
export const totalDelay = (p) => p.delay + p.measurement_delay + p.output_delay;

/**
 * The loop in continuous time: A = (m s^2 + c s + k) (1 + 2 zeta s/wn + s^2/wn^2) (1 + s tau),
 * B = (1 + s tau) exp(-s td), C = s exp(-s td), tau = 1 / velocity_filter.
 *
 * `parts(sigma, w)` gives A, B, C at s = sigma + j w with their derivatives; `degree` is that of A,
 * `end` the highest frequency [rad/s], `lag` the longest delay in the phase [s].
 */
export function continuousLoop(p) {
  const { mass, wn, zeta, joint_damping: c, joint_stiffness: k } = p;
  const delay = totalDelay(p);
  const tau = 1 / p.velocity_filter;
  const servo = wn === Infinity ? [1] : [1, (2 * zeta) / wn, 1 / (wn * wn)];
  const filter = tau > 0 ? [1, tau] : [1];

  function parts(sigma, w) {
    const s = jet(sigma, w, 1, 0);
    const late = exponential(scaled(s, -delay));
    const filtered = polynomial(filter, s);
    const plant = times(polynomial([k, c, mass], s), polynomial(servo, s));
    return { A: times(plant, filtered), B: times(filtered, late), C: times(s, late) };
  }

  const degree = 2 + (servo.length - 1) + (filter.length - 1);
  return { parameters: p, parts, degree, end: Infinity, lag: delay, sampled: false };
}

/**
 * The loop as its controller samples it at T: with u = exp(-s T) = 1/z and S = 1 - u,
 * A = J(S) Q(S), B = u^(d+1) P(u), C = u^(d+1) V(u), from the first responses to a pulse; of the
 * differenced velocity A (1 - b u), B (1 - b u) and C = B S (1 - b) / T, b = exp(-velocity_filter T).
 */
export function sampledLoop(p) {
  const period = 1 / p.control_rate;
  const { phi, older, newer, joint, servo, steps } = periodMap(p);
  const inServo = quadratic(servo);
  const inJoint = quadratic(joint);
  const bare = p.joint_damping === 0 && p.joint_stiffness === 0;
  const single = convolved(inDelays(inServo), bare ? [1, -1] : inDelays(inJoint));
  const double = bare ? convolved(single, [1, -1]) : single;
  const pulse = [newer, applied(phi, newer).map((x, i) => x + older[i])];
  for (let i = 0; i < 3; i++) pulse.push(applied(phi, pulse[pulse.length - 1]));
  const position = convolved(
    double,
    pulse.map((x) => x[0]),
  ).slice(0, 5);
  const velocity = convolved(
    single,
    pulse.map((x) => x[1]),
  ).slice(0, single.length);
  const differenced = p.velocity === "differenced";
  const pole = Math.exp(-p.velocity_filter * period);

  function parts(sigma, w) {
    const s = jet(sigma, w, 1, 0);
    const u = exponential(scaled(s, -period));
    const S = oneLessExponential(scaled(s, -period));
    const hold = exponential(scaled(s, -period * (steps + 1)));
    const A = times(bare ? times(S, S) : polynomial(inJoint, S), polynomial(inServo, S));
    const B = times(hold, polynomial(position, u));
    if (differenced) {
      const lowpass = plus(jet(1 - pole), scaled(S, pole));
      const C = scaled(times(B, S), (1 - pole) / period);
      return { A: times(A, lowpass), B: times(B, lowpass), C };
    }
    const C = times(hold, polynomial(velocity, u));
    return { A, B, C: bare ? times(C, S) : C };
  }

  const end = Math.PI / period;
  return { parameters: p, parts, degree: 0, end, lag: totalDelay(p) + 4 * period, sampled: true };
}

/** x_{k+1} = Phi x_k + older u_{k-d-1} + newer u_{k-d}, x = (q, v, f, f'/wn), exact for any delay. */
export function periodMap(p) {
  const period = 1 / p.control_rate;
  const delay = totalDelay(p);
  const steps = Math.floor(delay / period);
  const remainder = Math.min(Math.max(delay - steps * period, 0), period);
  const whole = transition(period, p);
  const early = transition(remainder, p);
  const late = transition(period - remainder, p);
  const older = applied(late.phi, early.gamma);
  return { ...whole, older, newer: late.gamma, steps, remainder };
}

/** The state some time after the beginning of a period, 0 <= time <= T, by (x, older, newer). */
export function within(p, remainder, time) {
  const early = transition(Math.min(time, remainder), p);
  if (time <= remainder) return (x, older) => advanced(early, x, older);
  const late = transition(time - remainder, p);
  return (x, older, newer) => advanced(late, advanced(early, x, older), newer);
}

/** (q0, q1, q2) of det(1 - F u) = q0 + q1 S + q2 S^2 from F - 1, shape (2, 2). */
function quadratic([[a, b], [c, d]]) {
  const q0 = a * d - b * c;
  return [q0, -(a + d) - 2 * q0, 1 + a + d + q0];
}

/** The same polynomial by powers of u. */
const inDelays = ([, q1, q2]) => [1, -(q1 + 2 * q2), q2];

/** Coefficients of a product of two polynomials. */
function convolved(a, b) {
  const total = new Array(a.length + b.length - 1).fill(0);
  a.forEach((x, i) => b.forEach((y, j) => (total[i + j] += x * y)));
  return total;
}
