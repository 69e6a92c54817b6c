// The page's mathematics against the oracle, and against loops that Python has looked at.
//
//   node --test tests/reports/
//
// pytest writes Python's loops to a file and names it in JAXACT_LOOPS.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { boundary, marginalGains } from "../../jaxact/reports/page/boundary.js";
import { frequencyGrid, responses } from "../../jaxact/reports/page/frequencies.js";
import { fields, levelLine, QUANTITIES } from "../../jaxact/reports/page/levels.js";
import { continuousLoop, sampledLoop } from "../../jaxact/reports/page/loops.js";
import { margins } from "../../jaxact/reports/page/margins.js";
import { rightmostRoot, unstableRoots } from "../../jaxact/reports/page/roots.js";
import { stepResponse } from "../../jaxact/reports/page/step_response.js";
import { exponentialLessOne } from "../../jaxact/reports/page/transition.js";

const TOLERANCE = 1e-6;
const oracle = JSON.parse(readFileSync(new URL("../data/paper_loop.json", import.meta.url)));
const BARE = {
  mass: 0.7,
  wn: Infinity,
  zeta: 1,
  delay: 0,
  measurement_delay: 0,
  output_delay: 0,
  setpoint_delay: 0,
  control_rate: 1000,
  velocity_filter: Infinity,
  joint_damping: 0,
  joint_stiffness: 0,
  velocity: "sampled",
};

const number = (x) => (x === "inf" ? Infinity : x);

function near(own, other, words, absolute = 0) {
  if (own === other) return;
  const far = Math.abs(own - other);
  assert.ok(far <= absolute + TOLERANCE * Math.abs(other), `${words}: ${own}, not ${other}`);
}

function prepared(make, p, kp, kd, factor = 10) {
  const loop = make(p);
  const window = { kp: [kp / factor, kp * factor], kd: [kd / factor, kd * factor] };
  const grid = frequencyGrid(loop, window);
  return { loop, window, grid, cached: responses(loop, grid) };
}

function all(make, p, kp, kd) {
  const { loop, grid, cached } = prepared(make, p, kp, kd);
  const root = rightmostRoot(loop, kp, kd, grid);
  return { ...margins(loop, cached, kp, kd), spectral_abscissa: root.re };
}

function ofCase(one) {
  const { mass, delay, natural_frequency: wn, damping_ratio: zeta } = one;
  return { ...BARE, mass, delay, wn: wn ?? Infinity, zeta: zeta ?? 1 };
}

for (const kd of [5, -5]) {
  for (const [wn, delay] of [[Infinity, 0], [Infinity, 1e-3], [800, 0], [800, 1e-3]]) {
    for (const make of [continuousLoop, sampledLoop]) {
      test(`nothing holds the joint: ${make.name}, kd ${kd}, wn ${wn}, delay ${delay}`, () => {
        // s = 0 is a root, and with a negative kd another one grows.
        const p = { ...BARE, wn, zeta: 0.45, delay, joint_stiffness: -100 };
        const { loop, cached } = prepared(make, p, 100, Math.abs(kd));
        assert.equal(margins(loop, cached, 100, kd).unstable_roots, kd > 0 ? 1 : 2);
      });
    }
  }
}

for (const one of [...oracle.paper_cases, ...oracle.frequency_sweep]) {
  test(`oracle: ${one.name ?? `wn ${one.natural_frequency}, zeta ${one.damping_ratio}`}`, () => {
    const found = all(continuousLoop, ofCase(one), one.kp, one.kd);
    assert.equal(found.unstable_roots, one.unstable_roots);
    near(found.spectral_abscissa, one.spectral_abscissa, "spectral_abscissa");
    if (one.unstable_roots > 0) return;
    // The oracle found the gain margin by bisection.
    assert.ok(
      Math.abs(Math.log(found.gain_margin / number(one.gain_margin))) < 1e-4 ||
        found.gain_margin === number(one.gain_margin),
    );
    near((found.phase_margin * 180) / Math.PI, one.phase_margin_deg, "phase_margin");
    near(found.delay_margin, number(one.delay_margin), "delay_margin");
    near(found.sensitivity_peak, one.sensitivity_peak, "sensitivity_peak");
    near(found.complementary_peak, one.complementary_peak, "complementary_peak");
    near(found.disk_margin, one.disk_margin_balanced, "disk_margin");
  });
}

test("sampled loops of the oracle", () => {
  oracle.sampled_1khz.forEach((one, i) => {
    const { kp, kd } = oracle.paper_cases[i];
    const kinds = { velocity_sampled: "sampled", velocity_backward_difference: "differenced" };
    for (const [name, velocity] of Object.entries(kinds)) {
      const found = all(sampledLoop, { ...ofCase(oracle.paper_cases[i]), velocity }, kp, kd);
      near(Math.exp(found.spectral_abscissa / 1000), one[name].rho, `${one.name}: rho`);
      assert.equal(found.stable, one[name].stable);
      // found on a grid there
      assert.ok(Math.abs(found.sensitivity_peak / one[name].Ms - 1) < 1e-4);
    }
  });
});

test("the delay margin of sampled loops whose crossover moves within a control period", () => {
  // Where the spectral radius of matrix exponentials passes 1; the first loop returns soon after.
  const flat = { mass: 3.2451791882392436, joint_damping: 986.9419349462918 };
  const held = { joint_stiffness: 12421.204122554882, control_rate: 28.04960442563503 };
  const servo = { mass: 0.64036963452021, wn: 261.0555363394181, zeta: 0.7429653162214783 };
  const late = { joint_stiffness: 8252.292712094288, control_rate: 20.382883155007505 };
  for (const [own, kp, kd, margin] of [
    [{ ...flat, ...held, delay: 0.000322232153259587 }, 13804.109639860151, 197.38838698925835, 0.391312],
    [{ ...servo, ...late, delay: 0.007774095645005471 }, 1618.9270880632919, 10.886257256768877, 0.0210078],
  ]) {
    const { loop, cached } = prepared(sampledLoop, { ...BARE, ...own }, kp, kd);
    const far = margins(loop, cached, kp, kd).delay_margin / margin - 1;
    assert.ok(Math.abs(far) < 3e-6, `${margin}: ${far}`);
  }
});

test("a peak of |S| among many heights of nearly 1 is found in every window", () => {
  const p = { ...BARE, mass: 0.05848851059478379, wn: 1443.5689577321787, zeta: 0.5690908464288064 };
  const [kp, kd, k] = [0.9685160928879101, 5.802455000485818, 545.5333825625895];
  let highest = 0;
  for (let w = 900; w < 980; w += 0.01) {
    // 1 / S - 1 = (kp + kd s) / (m s^2 + k) A(s)
    const [re, im] = [1 - (w / p.wn) ** 2, (2 * p.zeta * w) / p.wn];
    const bottom = (k - p.mass * w * w) * (re * re + im * im);
    const [lr, li] = [(kp * re + kd * w * im) / bottom, (kd * w * re - kp * im) / bottom];
    highest = Math.max(highest, 1 / Math.hypot(1 + lr, li));
  }
  for (const factor of [3, 10, 30, 100]) {
    const own = { ...p, joint_stiffness: k };
    const { loop, cached } = prepared(continuousLoop, own, kp, kd, factor);
    near(margins(loop, cached, kp, kd).sensitivity_peak, highest, `window ${factor}`);
  }
});

test("what is no number at the resonance of an undamped joint hides no peak", () => {
  const p = { ...BARE, mass: 0.166, joint_stiffness: 19.2, wn: 75, zeta: 1 };
  const [kp, kd] = [0.425, 5.79];
  let highest = 0;
  for (let w = 0.005; w < 300; w += 0.01) {
    // 2 |S - 1/2| = |D - N| / |D + N|, L = N / D
    const free = 19.2 - 0.166 * w * w;
    const [re, im] = [free * (1 - (w / 75) ** 2), (free * 2 * w) / 75];
    highest = Math.max(highest, Math.hypot(re - kp, im - kd * w) / Math.hypot(re + kp, im + kd * w));
  }
  for (const factor of [3, 10, 30, 100]) {
    const { loop, cached } = prepared(continuousLoop, p, kp, kd, factor);
    near(margins(loop, cached, kp, kd).disk_margin, 2 / highest, `window ${factor}`);
  }
});

test("exp(A) - 1 of a rotation, however large and small", () => {
  for (const x of [1e-9, 0.3, 7, 40]) {
    const [[a, b]] = exponentialLessOne([
      [0, x],
      [-x, 0],
    ]);
    near(a, -2 * Math.sin(x / 2) ** 2, "cos - 1", 1e-12);
    near(b, Math.sin(x), "sin", 1e-12);
  }
});

test("the ideal joint answers a step as its closed form", () => {
  // Sampled finely, m q'' + kd q' + kp q = kp.
  const p = { ...BARE, mass: 1, control_rate: 1e5 };
  const { time, position } = stepResponse(p, 100, 20, 20_000);
  time.forEach((t, i) => {
    if (i % 1000 === 0)
      assert.ok(Math.abs(position[i] - (1 - (1 + 10 * t) * Math.exp(-10 * t))) < 1e-4);
  });
});

test("beside the boundary one side is stable", () => {
  const p = { ...BARE, wn: 110, zeta: 0.9, delay: 0.005 };
  const { loop, window, cached } = prepared(sampledLoop, p, 400, 20, 100);
  const edges = boundary(loop, cached, window).filter(({ separates }) => separates);
  assert.ok(edges.length > 0);
  for (const { kp, kd, w } of edges) {
    kp.forEach((value, i) => {
      if (w[i] > 0 && w[i] < loop.end) near(marginalGains(loop, w[i])[0], value, "kp");
    });
    const i = kp.length >> 1;
    const counts = [0.99, 1.01].map((f) => unstableRoots(loop, cached, f * kp[i], kd[i]) > 0);
    assert.notEqual(counts[0], counts[1]);
  }
});

test("level lines of the gain margin know where a sampled loop is real, and no factor below 1", () => {
  // Ideal at 500 Hz: L(-1) = -kd T / (2 m), so that the gain margin is 2 m / (kd T).
  const p = { ...BARE, control_rate: 500 };
  const { loop, window, cached } = prepared(sampledLoop, p, 10, 437, 1.05);
  const { values } = fields(loop, cached, window, "gain_margin", 2);
  near(Math.exp(values[0]), (2 * 0.7 * 500) / window.kd[0], "gain margin");
  const still = prepared(continuousLoop, { ...BARE, joint_stiffness: -100 }, 200, 20, 1.05);
  const topples = fields(still.loop, still.cached, still.window, "gain_margin", 2);
  assert.ok(topples.values.every((x) => x > 2), `${topples.values}`);
});

test("a setpoint's delay is linear between ticks", () => {
  // By jaxact.simulate at ticks 0 to 7, in float64.
  const p = { ...BARE, wn: 110, zeta: 0.9, delay: 0.001, control_rate: 100 };
  const simulated = {
    0.025: [0, 0, 0, 0.00067, 0.00993, 0.04516, 0.1212, 0.24157],
    0.024: [0, 0, 0, 0.0008, 0.01165, 0.05048, 0.13108, 0.25577],
  };
  for (const [late, wanted] of Object.entries(simulated)) {
    const { position } = stepResponse({ ...p, setpoint_delay: Number(late) }, 400, 20, 7);
    wanted.forEach((x, i) => assert.ok(Math.abs(position[i] - x) < 1e-5, `${late} ${i}: ${position[i]}`));
  }
});

test("level lines pass where the margin has the level", () => {
  const p = { ...BARE, wn: 110, zeta: 0.9, delay: 0.001 };
  const { loop, window, cached } = prepared(continuousLoop, p, 400, 20, 5);
  const count = 60;
  const gains = ([low, high], at) => low * (high / low) ** (at / (count - 1));
  const levels = { sensitivity_peak: 2, gain_margin: 3, phase_margin: 30, delay_margin: 5 };
  const units = { phase_margin: 180 / Math.PI, delay_margin: 1000 };
  for (const [name, level] of Object.entries(levels)) {
    const { values } = fields(loop, cached, window, name, count);
    const line = levelLine(values, count, QUANTITIES[name].field(level));
    assert.ok(line.length > 5, name);
    for (const [x, y] of line) {
      const there = margins(loop, cached, gains(window.kp, x), gains(window.kd, y))[name];
      assert.ok(Math.abs((there * (units[name] ?? 1)) / level - 1) < 0.05, `${name}: ${there}`);
    }
  }
});

const given = process.env.JAXACT_LOOPS;
const rows = given ? JSON.parse(readFileSync(given)) : [];
const SKIPPED = new Set(["stable", "more_crossovers", "log_gain_to_boundary", "spectral_radius"]);

test("random loops have Python's margins", { skip: !given && "run by pytest" }, () => {
  assert.ok(rows.length > 0);
  for (const { loop: raw, continuous, sampled } of rows) {
    const p = Object.fromEntries(Object.entries(raw).map(([name, x]) => [name, number(x)]));
    for (const [make, theirs] of [
      [continuousLoop, continuous],
      [sampledLoop, sampled],
    ]) {
      const own = all(make, p, p.kp, p.kd);
      own.phase_margin *= 180 / Math.PI;
      for (const [name, value] of Object.entries(theirs)) {
        if (SKIPPED.has(name) || value === null) continue; // null: means nothing there
        // The undamped resonance of a spring leaves 1e-7 there, rounding, for 0.
        const absolute = name === "gain_reduction_margin" ? TOLERANCE : 0;
        near(own[name], number(value), `${name} of ${JSON.stringify(raw)}`, absolute);
      }
    }
  }
});

test("random loops have Python's boundary", { skip: !given && "run by pytest" }, () => {
  let compared = 0;
  for (const { loop: raw, boundaries } of rows.filter((row) => row.boundaries?.length)) {
    const p = Object.fromEntries(Object.entries(raw).map(([name, x]) => [name, number(x)]));
    for (const [make, points] of [
      [continuousLoop, boundaries[0]],
      [sampledLoop, boundaries[1]],
    ]) {
      compared += points.length;
      for (const [w, kp, kd] of points) {
        const own = marginalGains(make(p), w);
        near(own[0], kp, "kp", 1e-9 * p.kp);
        near(own[1], kd, "kd", 1e-9 * p.kd);
      }
    }
  }
  assert.ok(compared > 50);
});

test("random loops step as the simulated ones", { skip: !given && "run by pytest" }, () => {
  const stepped = rows.filter((row) => row.step);
  assert.ok(stepped.length > 0);
  for (const { loop: raw, step } of stepped) {
    const p = Object.fromEntries(Object.entries(raw).map(([name, x]) => [name, number(x)]));
    const { position } = stepResponse(p, p.kp, p.kd, step.length - 1);
    const largest = Math.max(...step.map(Math.abs));
    step.forEach((value, i) => near(position[i], value, `tick ${i}`, TOLERANCE * largest));
  }
});
