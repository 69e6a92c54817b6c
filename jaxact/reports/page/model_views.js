// The ladder of models, frequency response, autocorrelation and profile likelihoods of a drive.

import { draw, frame, line, table } from "./chart.js";
import { spanOf } from "./log_view.js";

const HEIGHT = 240;
const HIGHEST_RISE = 3;

/** Hide the figure of a picture that has nothing to show; gives whether it has. */
function figure(svg, there) {
  svg.closest("figure").hidden = !there;
  return there;
}

function dot(place, x, y, attributes) {
  place.inside.append(draw("circle", { cx: place.x(x), cy: place.y(y), ...attributes }));
}

/** Error on unseen logs over the number of unknowns. */
export function drawLadder(svg, { ladder, error_unit: unit }) {
  if (!figure(svg, ladder.length > 0)) return;
  const sizes = ladder.map((one) => one.unknowns);
  const errors = ladder.map((one) => one.error);
  const [least, largest] = [Math.min(...errors), Math.max(...errors)];
  const log = least > 0 && largest > 8 * least;
  const place = frame(svg, {
    x: { domain: [Math.min(...sizes) - 0.5, Math.max(...sizes) + 0.5], log: false, label: "unknowns" },
    y: {
      domain: [log ? least / 1.5 : 0, (log ? 1.5 : 1.1) * largest],
      log,
      label: `unseen error [${unit}]`,
    },
    height: HEIGHT,
  });
  for (const { name, unknowns, error, identified, chosen } of ladder) {
    const kind = `${chosen ? "chosen" : "tried"}${identified ? "" : " hollow"}`;
    dot(place, unknowns, error, { class: kind, r: chosen ? 7 : 4 });
    if (!chosen) continue;
    const right = place.x(unknowns) > (place.left + place.right) / 2;
    const at = { x: place.x(unknowns) + (right ? -11 : 11), y: place.y(error) - 9 };
    const anchor = right ? "end" : "start";
    place.inside.append(draw("text", { class: "mark-label", ...at, "text-anchor": anchor }, name));
  }
}

/** A band between two curves. */
function band(place, xs, lows, highs) {
  const back = (values) => [...values].reverse();
  line(place, [...xs, ...back(xs)], [...lows, ...back(highs)], { class: "band" });
}

/** Measured with its band, and the model's, over frequency; `found` is null where none is coherent. */
export function drawResponse(gain, phase, found) {
  figure(gain, found !== null);
  if (!figure(phase, found !== null)) return;
  const w = found.frequency;
  const x = { domain: [w[0], w[w.length - 1]], log: true, label: "frequency [Hz]" };
  const lows = found.gain.map((value, i) => value * Math.max(1 - found.half[i], 1e-3));
  const highs = found.gain.map((value, i) => value * (1 + found.half[i]));
  const all = [...found.gain, ...found.model_gain];
  const upper = frame(gain, {
    x,
    y: { domain: [0.7 * Math.min(...all), 1.4 * Math.max(...all)], log: true, label: "gain" },
    height: HEIGHT,
  });
  band(upper, w, lows, highs);
  line(upper, w, found.gain, { class: "measured" });
  line(upper, w, found.model_gain, { class: "simulated" });
  const lower = frame(phase, {
    x,
    y: { domain: spanOf([...found.phase, ...found.model_phase]), log: false, label: "phase [°]" },
    height: HEIGHT,
  });
  const half = found.half.map((value) => (value * 180) / Math.PI);
  const shifted = (sign) => found.phase.map((value, i) => value + sign * half[i]);
  band(lower, w, shifted(-1), shifted(1));
  line(lower, w, found.phase, { class: "measured" });
  line(lower, w, found.model_phase, { class: "simulated" });
}

/** Autocorrelation of the residual with the band of white noise. */
export function drawAutocorrelation(svg, found) {
  if (!figure(svg, found !== null)) return;
  const { lags, values, band: half } = found;
  const x = [0, lags[lags.length - 1] + 1];
  const place = frame(svg, {
    x: { domain: x, log: false, label: "lag [rows]" },
    y: { domain: [-1, 1], log: false, label: "autocorrelation" },
    height: HEIGHT,
  });
  band(place, x, [-half, -half], [half, half]);
  line(place, x, [0, 0], { class: "reference" });
  lags.forEach((lag, i) => line(place, [lag, lag], [0, values[i]], { class: "rest" }));
}

/** The profile likelihood of every number, a picture each. */
export function drawProfiles(container, { profiles, estimates }) {
  const made = profiles.map(({ name }, i) => {
    const words = `Profile likelihood of ${name}`;
    const svg = draw("svg", { id: `profile-${i}`, role: "img", "aria-label": words });
    const picture = Object.assign(document.createElement("div"), { className: "picture" });
    picture.append(svg);
    const caption = document.createElement("figcaption");
    caption.textContent = `${words}: rise of the sum of squares, 1 at the ends of the 95 % interval`;
    const whole = document.createElement("figure");
    whole.append(picture, caption);
    return { svg, whole };
  });
  container.replaceChildren(...made.map(({ whole }) => whole));
  profiles.forEach(({ name, values, rises }, i) => {
    const { unit, value, low, high } = estimates.find((one) => one.name === name);
    const [first, last] = [values[0], values[values.length - 1]];
    const place = frame(made[i].svg, {
      x: {
        domain: last > first ? [first, last] : spanOf(values),
        log: false,
        label: unit === "1" ? name : `${name} [${unit}]`,
      },
      y: { domain: [-0.1, HIGHEST_RISE], log: false, label: "rise" },
      height: HEIGHT,
    });
    const ends = [Math.max(low, first), Math.min(high, last)];
    band(place, ends, [-1, -1], [HIGHEST_RISE, HIGHEST_RISE]);
    line(place, [first, last], [1, 1], { class: "reference" });
    line(place, values, rises, { class: "rest" });
    values.forEach((x, at) => dot(place, x, rises[at], { class: "tried", r: 3 }));
    dot(place, value, 0, { class: "chosen", r: 5 });
  });
}

/** Tables behind all of these. */
export function modelTables({ ladder, error_unit: unit, response, autocorrelation, profiles }) {
  const column = (rows, head, value) => ({ head, values: rows.map(value) });
  const found = [];
  if (ladder.length) {
    found.push(
      table("The models", [
        column(ladder, "model", ({ name, chosen }) => (chosen ? `${name} (chosen)` : name)),
        column(ladder, "unknowns", (one) => one.unknowns),
        column(ladder, `error on unseen logs [${unit}]`, (one) => one.error),
        column(ladder, "score [%]", (one) => one.score),
        column(ladder, "all identified", (one) => (one.identified ? "yes" : "NO")),
      ]),
    );
  }
  if (response) {
    found.push(
      table("Frequency response", [
        { head: "frequency [Hz]", values: response.frequency },
        { head: "gain, measured", values: response.gain },
        { head: "of the model", values: response.model_gain },
        { head: "half of the 95 % band, as a share", values: response.half },
        { head: "phase, measured [°]", values: response.phase },
        { head: "of the model [°]", values: response.model_phase },
      ]),
    );
  }
  if (autocorrelation) {
    found.push(
      table("Autocorrelation of the residual", [
        { head: "lag [rows]", values: autocorrelation.lags },
        { head: "autocorrelation", values: autocorrelation.values },
      ]),
    );
  }
  for (const { name, values, rises } of profiles) {
    found.push(
      table(`Profile likelihood of ${name}`, [
        { head: name, values },
        { head: "rise", values: rises },
      ]),
    );
  }
  return found;
}
