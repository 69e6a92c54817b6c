// A robot's mathematics in the page against robots that Python has looked at.
//
//   pytest tests/reports/test_robot_report.py
//
// pytest writes Python's robots to a file and names it in JAXACT_ROBOTS.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import {
  eigenvalues, inverse, largestSingularValue, shifted, singularValues, zeros,
} from "../../jaxact/reports/page/matrices.js";
import { bound, diskMargin } from "../../jaxact/reports/page/robot_disk.js";
import { glance, roughly } from "../../jaxact/reports/page/robot_glance.js";
import * as limits from "../../jaxact/reports/page/robot_limits.js";
import * as closed from "../../jaxact/reports/page/robot_loop.js";
import * as margins from "../../jaxact/reports/page/robot_margins.js";
import { stepResponse } from "../../jaxact/reports/page/robot_step.js";
import { openRobot, plantOf } from "../../jaxact/reports/page/robot_response.js";

const EXACT = 1e-6;
const SHARE = 0.02;
const PICTURED = 0.03;
const given = process.env.JAXACT_ROBOTS;
const skip = !given && "run by pytest";
const rows = given
  ? JSON.parse(readFileSync(given), (_, value) => (value === "inf" ? Infinity : value))
  : [];

function near(own, other, tolerance, words) {
  if (own === other) return;
  assert.ok(Math.abs(own - other) <= tolerance * Math.abs(other), `${words}: ${own}, not ${other}`);
}

const { finished } = closed;

const random = (n) => {
  const M = zeros(n);
  for (let k = 0; k < n * n; k++) [M.re[k], M.im[k]] = [Math.sin(7 * k * k + 1), Math.cos(3 * k * k)];
  return M;
};

test("eigenvalues, singular values and the inverse of a matrix", () => {
  for (const n of [1, 2, 3, 8, 20]) {
    const M = random(n);
    const roots = eigenvalues(M);
    const trace = { re: 0, im: 0 };
    for (let i = 0; i < n; i++) {
      trace.re += M.re[i * (n + 1)];
      trace.im += M.im[i * (n + 1)];
    }
    for (const part of ["re", "im"]) {
      const sum = roots.reduce((all, one) => all + one[part], 0);
      assert.ok(Math.abs(sum - trace[part]) < 1e-12 * n * n);
    }
    const square = M.re.reduce((all, x, k) => all + x * x + M.im[k] * M.im[k], 0);
    const sizes = singularValues(M);
    near(largestSingularValue(M), sizes[0], 1e-12, "the largest");
    near(roughly(M, 0, 1), sizes[0], n > 8 ? PICTURED : 1e-8, "the largest, roughly");
    near(sizes.reduce((all, x) => all + x * x, 0), square, 1e-12, "Frobenius");
    near(singularValues(inverse(M))[0], 1 / sizes[n - 1], 1e-9, "of the inverse");
    // M - l I is singular
    for (const { re, im } of roots) {
      const less = shifted(M, -re, 1);
      for (let i = 0; i < n; i++) less.im[i * (n + 1)] -= im;
      assert.ok(singularValues(less)[n - 1] < 1e-11 * sizes[0]);
    }
  }
});

test("the bound of mu is mu where that is known, and never below it", () => {
  // For up to three joints it is the largest spectral radius of U H over diagonal unitary U.
  const ring = zeros(3);
  [ring.re[1], ring.re[5], ring.re[6]] = [8, 1, 1];
  near(finished(bound(ring)).value, 2, 1e-8, "a ring: the cube root of the product");
  for (const n of [2, 3, 5]) {
    const H = random(n);
    const { value } = finished(bound(H));
    let most = 0;
    for (let k = 0; k < 2000; k++) {
      const turned = zeros(n);
      for (let at = 0; at < n * n; at++) {
        const angle = 2 * Math.PI * ((k * Math.sqrt(2 + 3 * Math.floor(at / n))) % 1);
        const [c, s] = [Math.cos(angle), Math.sin(angle)];
        [turned.re[at], turned.im[at]] = [c * H.re[at] - s * H.im[at], s * H.re[at] + c * H.im[at]];
      }
      most = Math.max(most, ...eigenvalues(turned).map(({ re, im }) => Math.hypot(re, im)));
    }
    assert.ok(most <= value * (1 + 1e-9) && most > 0.97 * value, `${n}: ${most} of ${value}`);
  }
});

/** A robot of Python's with its loop closed, which is opened and looked at once for all that follows. */
function opened(row) {
  const { data } = row;
  const [own] = data.loops;
  const plant = plantOf(data.plants[own.plants[own.rate]], data.joints.length);
  const open = openRobot(plant, own.drives, data.velocity === "differenced");
  const fine = closed.responses(open, true);
  return { row, plant, fine, loop: closed.closedLoop(fine, own.drives.kp, own.drives.kd) };
}

function singularValuesArePythons({ row, loop }) {
  row.angle.forEach((t, k) => {
    const S = closed.sensitivityOf(loop.at(t));
    const both = { S, T: shifted(S, 1, -1) };
    for (const name of ["S", "T"]) {
      singularValues(both[name]).forEach((value, i) => {
        const far = Math.abs(value - row[name][k][i]);
        assert.ok(far < EXACT * row[name][k][0], `${row.robot}: ${name} ${value} at ${t}`);
      });
    }
  });
}

function marginsArePythons({ row, loop, plant }) {
  const growth = finished(margins.growth(loop));
  assert.equal(growth.unstable_roots, row.unstable_roots, row.robot);
  assert.notEqual(growth.rate, null, row.robot);
  near(growth.rate, row.growth_rate, EXACT, `${row.robot}: growth rate`);
  const words = [growth.shakes && "shakes", growth.topples && "topples"].filter((one) => one);
  assert.equal(words.join(" and ") || "stable", row.verdict, row.robot);
  if (!row.whole) return;
  finished(margins.sharpen(loop, growth.roots));
  const found = finished(margins.peaks(loop));
  for (const name of ["sensitivity_peak", "complementary_peak", "unscaled_disk_margin"]) {
    near(found[name], row.whole[name], EXACT, `${row.robot}: ${name}`);
  }
  const disk = finished(diskMargin(loop));
  near(disk.margin, row.whole.disk_margin, EXACT, `${row.robot}: disk margin`);
  const up = finished(limits.gainLimit(loop, true));
  near(up?.factor ?? Infinity, row.whole.gain_margin, EXACT, `${row.robot}: gain margin`);
  const down = finished(limits.gainLimit(loop, false));
  near(down?.factor ?? 0, row.whole.gain_reduction_margin, EXACT, `${row.robot}: gains down`);
  const later = finished(limits.delayLimit(loop));
  near(later?.delay ?? Infinity, row.whole.delay_margin, EXACT, `${row.robot}: delay margin`);
  if (later && row.first) {
    // Which of two legs that are alike is named is rounding.
    const own = margins.lateShape(loop, later, plant.inertias);
    for (const [name, places] of Object.entries(row.data.groups)) {
      const sum = (share) => places.reduce((all, i) => all + share(i), 0);
      const [here, there] = [sum((i) => own[i].share), sum((i) => row.first[i])];
      assert.ok(Math.abs(here - there) < SHARE, `${row.robot}: ${name}: ${here}, not ${there}`);
    }
  }
  ofJoints(loop, row);
}

function ofJoints(loop, row) {
  const names = ["sensitivity_peak", "complementary_peak", "disk_margin", "phase_margin", "delay_margin", "gain_margin"];
  row.joints.forEach((joint, i) => {
    const own = finished(margins.ofJoint(loop, i));
    for (const name of names) near(own[name], joint[name], EXACT, `${row.robot}: ${name} of ${joint.name}`);
    // That of a joint that stays stable with almost none of its gains is rounding.
    const [here, there] = [own.gain_reduction_margin, joint.gain_reduction_margin];
    if (Math.max(here, there) > EXACT) near(here, there, EXACT, `${row.robot}: gains of ${joint.name} down`);
  });
}

function stepsArePythons({ row, loop, plant }) {
  const { drives } = loop.open;
  const [which, ticks] = [row.data.joints.length - 1, row.step.length - 1];
  const differenced = row.data.velocity === "differenced";
  const { time, positions } = finished(stepResponse(plant, drives, differenced, which, ticks));
  assert.ok(time.length > 10, row.robot);
  const largest = Math.max(...row.step.slice(0, time.length).flat().map(Math.abs));
  time.forEach((t, k) => {
    near(t, k * loop.open.period, 1e-12, "time");
    positions.forEach((all, i) => {
      const far = Math.abs(all[k] - row.step[k][i]);
      assert.ok(far < EXACT * largest, `${row.robot}: joint ${i} at tick ${k}: off by ${far}`);
    });
  });
  // What grows beyond all bounds is left off there, and only that.
  if (time.length <= ticks) assert.ok(positions.some((all) => Math.abs(all.at(-1)) >= 20));
}

function firstGlancesArePythons({ row, loop, fine }) {
  const { open, kp, kd } = loop;
  const coarse = closed.responses(open, false);
  const found = finished(glance(coarse, kp, kd));
  assert.equal(found.unstable, row.unstable_roots, row.robot);
  for (const { t, peaks } of found.points) {
    const S = closed.sensitivityOf(loop.at(t));
    near(peaks[0], largestSingularValue(S), PICTURED, `${row.robot}: S at ${t}`);
    near(peaks[1], largestSingularValue(shifted(S, 1, -1)), PICTURED, `${row.robot}: T at ${t}`);
  }
  // With other gains as the eigenvalues of L count.
  for (const [i, factor] of [0.03, 0.3, 3, 30].entries()) {
    const [stiff, damping] = [kp, kd].map((own, k) => own.map((x, j) => x * factor * (1 + ((i + j + k) % 3))));
    const other = closed.closedLoop(fine, stiff, damping);
    const { unstable } = finished(glance(coarse, stiff, damping));
    assert.equal(unstable, other.count(1), `${row.robot}: gains times ${factor}`);
  }
}

for (const row of rows) {
  test(row.robot, async (t) => {
    const robot = opened(row);
    await t.test("has Python's singular values", () => singularValuesArePythons(robot));
    await t.test("answers a step as Python's loop over its periods", () => stepsArePythons(robot));
    await t.test("has Python's number of unstable roots at a first glance, and its outline", () =>
      firstGlancesArePythons(robot),
    );
    // The last: these put more points into the loop.
    await t.test("has Python's margins", () => marginsArePythons(robot));
  });
}

test("ranges of a map change where the margins are", { skip }, () => {
  const { row, loop } = opened(rows.find(({ whole }) => whole));
  const found = [...limits.ranges(loop)];
  const here = found.find(({ low, high }) => low < 1 && high > 1);
  assert.equal(here.unstable, 0);
  near(here.high, row.whole.gain_margin, 1e-2, "where gains become too high");
});
