// Bode, Nyquist and sensitivity plots of the loop, and its answer to a step.

import { draw, frame, line, table } from "./chart.js";
import { openLoop } from "./frequencies.js";
import { degrees } from "./words.js";

const POINTS = 400;
const ROWS = 40;
const HEIGHT = 260;
const FREQUENCY = "frequency [rad/s]";
const NEAR = 3;

/** L over frequencies around the crossovers, for all pictures: {w, L, gain, phase, S, T}. */
export function curves(loop, kp, kd, margins) {
  const rigid = Math.sqrt(kp / loop.parameters.mass);
  const middle = [
    rigid,
    margins.gain_crossover,
    margins.phase_crossover,
    margins.sensitivity_peak_frequency,
  ].filter((w) => w > 0 && w < Infinity);
  const low = Math.min(...middle) / 20;
  const high = Math.min(Math.max(...middle) * 10, loop.end);
  const w = Array.from({ length: POINTS }, (_, i) => low * (high / low) ** (i / (POINTS - 1)));
  const L = w.map((x) => openLoop(loop, kp, kd, x));
  let before = null;
  const phase = L.map(({ re, im }) => {
    // From -180 degrees, unwrapped.
    const angle = Math.atan2(-im, -re);
    before =
      before === null ? angle : angle + 2 * Math.PI * Math.round((before - angle) / (2 * Math.PI));
    return degrees(before) - 180;
  });
  return {
    w,
    L,
    phase,
    gain: L.map(({ re, im }) => Math.hypot(re, im)),
    S: L.map(({ re, im }) => 1 / Math.hypot(1 + re, im)),
    T: L.map(({ re, im }) => Math.hypot(re, im) / Math.hypot(1 + re, im)),
  };
}

const spanOf = (both) => {
  const all = Object.values(both).flatMap(({ w }) => w);
  return [all.reduce((a, b) => Math.min(a, b)), all.reduce((a, b) => Math.max(a, b))];
};

function bounded(both, name, least, most) {
  const values = Object.values(both)
    .flatMap((one) => one[name])
    .filter(Number.isFinite);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return [Math.min(Math.max(low, least[0]), least[1]), Math.max(Math.min(high, most[1]), most[0])];
}

/** Gain and phase of the open loop; `both` of `curves` by the class that each is drawn in. */
export function drawBode(gainPicture, phasePicture, both) {
  const x = { domain: spanOf(both), log: true, label: FREQUENCY };
  const gain = frame(gainPicture, {
    x,
    y: { domain: bounded(both, "gain", [1e-4, 0.1], [10, 1e4]), log: true, label: "|L|" },
    height: HEIGHT,
  });
  const phase = frame(phasePicture, {
    x,
    y: {
      domain: bounded(both, "phase", [-720, -270], [-90, 90]),
      log: false,
      label: "phase of L [°]",
    },
    height: HEIGHT,
  });
  line(gain, x.domain, [1, 1], { class: "reference" });
  line(phase, x.domain, [-180, -180], { class: "reference" });
  for (const kind of Object.keys(both)) {
    line(gain, both[kind].w, both[kind].gain, { class: kind });
    line(phase, both[kind].w, both[kind].phase, { class: kind });
  }
}

/** L in the plane around -1, with the circle |1 + L| = 1/Ms that it stays out of. */
export function drawNyquist(svg, both, peak) {
  const place = frame(svg, {
    x: { domain: [-NEAR, NEAR / 2], log: false, label: "Re L" },
    y: { domain: [-NEAR / 2, NEAR / 2], log: false, label: "Im L" },
    height: Math.min(Math.max(svg.parentElement.clientWidth, 240) * 0.62, 340),
  });
  const turns = Array.from({ length: 73 }, (_, i) => (i * Math.PI) / 36);
  line(place, turns.map(Math.cos), turns.map(Math.sin), { class: "reference" });
  if (peak > 0) {
    const near = [Math.cos, Math.sin].map((f) => turns.map((t) => f(t) / peak));
    line(
      place,
      near[0].map((x) => x - 1),
      near[1],
      { class: "disk" },
    );
  }
  for (const kind of Object.keys(both)) {
    const { L } = both[kind];
    line(
      place,
      L.map(({ re }) => re),
      L.map(({ im }) => im),
      { class: kind },
    );
  }
  place.inside.append(draw("circle", { class: "critical", cx: place.x(-1), cy: place.y(0), r: 4 }));
}

/** |S| and |T|. */
export function drawSensitivity(svg, both) {
  const values = Object.values(both)
    .flatMap(({ S, T }) => [...S, ...T])
    .filter(Number.isFinite);
  const top = Math.min(Math.max(...values) * 1.1, 20);
  const place = frame(svg, {
    x: { domain: spanOf(both), log: true, label: FREQUENCY },
    y: { domain: [0, top], log: false, label: "|S|, |T| (dashed)" },
    height: HEIGHT,
  });
  line(place, spanOf(both), [1, 1], { class: "reference" });
  for (const kind of Object.keys(both)) {
    line(place, both[kind].w, both[kind].S, { class: kind });
    line(place, both[kind].w, both[kind].T, { class: `${kind} other` });
  }
}

/** Answers to a unit step; `steps` of `stepResponse` by the class that each is drawn in. */
export function drawStep(svg, steps) {
  const each = Object.entries(steps);
  const finite = each.flatMap(([, { position }]) => position.filter((x) => Math.abs(x) < 1e6));
  const domain = [0, Math.max(...each.map(([, { time }]) => time[time.length - 1]))];
  const place = frame(svg, {
    x: { domain, log: false, label: "time [s]" },
    y: {
      domain: [Math.max(Math.min(0, ...finite), -1), Math.min(1.05 * Math.max(1.2, ...finite), 3)],
      log: false,
      label: "position per setpoint",
    },
    height: HEIGHT,
  });
  line(place, domain, [1, 1], { class: "reference" });
  for (const [kind, { time, position }] of each) line(place, time, position, { class: kind });
}

const rows = (values) => {
  const stride = Math.max(1, Math.ceil(values.length / ROWS));
  return Array.from(values).filter((_, i) => i % stride === 0);
};

/** Tables behind the pictures. */
export const curveTable = (name, one) =>
  table(`${name} over frequency`, [
    { head: FREQUENCY, values: rows(one.w) },
    { head: "|L|", values: rows(one.gain) },
    { head: "phase of L [°]", values: rows(one.phase) },
    { head: "|S|", values: rows(one.S) },
    { head: "|T|", values: rows(one.T) },
  ]);

export const stepTable = (step, of = "the sampled loop") =>
  table(`Answer of ${of} to a unit step of its setpoint`, [
    { head: "time [s]", values: rows(step.time) },
    { head: "position per setpoint", values: rows(step.position) },
  ]);
