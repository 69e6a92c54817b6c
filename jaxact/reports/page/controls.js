// Sliders with numbers beside them, one for each parameter of the loop.

import { short } from "./chart.js";
import { gainUnits } from "./words.js";

const STEPS = 1000;

/** What can be moved: scale, range and how it is shown; `factor` from SI to what is shown. */
function table(start, window, unit) {
  const rotary = unit === "rad";
  const [stiff, damping] = gainUnits(unit);
  const around = (value, low, high) =>
    value > 0 && value < Infinity
      ? [Math.min(low, value / 4), Math.max(high, value * 4)]
      : [low, high];
  const delay = (name, label) => ({
    name,
    label,
    unit: "ms",
    factor: 1000,
    log: false,
    range: [0, Math.max(0.02, 2 * start[name])],
  });
  const rows = [
    { name: "kp", label: "kp, stiffness", unit: stiff, log: true, range: window.kp },
    { name: "kd", label: "kd, damping", unit: damping, log: true, range: window.kd },
    {
      name: "wn",
      label: "wn, natural frequency of the actuator",
      unit: "rad/s",
      log: true,
      range: around(start.wn, 10, 5000),
      infinite: "ideal actuator",
    },
    {
      name: "zeta",
      label: "zeta, its damping ratio",
      unit: "",
      log: true,
      range: around(start.zeta, 0.05, 2),
    },
    delay("delay", "delay of the command"),
    delay("measurement_delay", "delay of the measurement"),
    delay("output_delay", "delay of the output"),
    {
      name: "mass",
      label: rotary ? "moved inertia" : "moved mass",
      unit: rotary ? "kg m²" : "kg",
      log: true,
      range: [start.mass / 10, start.mass * 10],
    },
    {
      name: "control_rate",
      label: "control rate",
      unit: "Hz",
      log: true,
      range: around(start.control_rate, 50, 5000),
    },
  ];
  const most = Math.max(start.joint_damping, window.kd[1] / 10);
  const stiffest = Math.max(Math.abs(start.joint_stiffness), window.kp[1] / 10);
  rows.push(
    {
      name: "joint_damping",
      label: "damping of the joint itself",
      unit: damping,
      log: false,
      range: [0, 2 * most],
    },
    {
      name: "joint_stiffness",
      label: "stiffness of the joint itself",
      unit: stiff,
      log: false,
      range: [-stiffest, stiffest],
    },
  );
  if (start.velocity === "differenced") {
    rows.push({
      name: "velocity_filter",
      label: "cutoff of the velocity's filter",
      unit: "rad/s",
      log: true,
      range: around(start.velocity_filter, 10, 5000),
      infinite: "no filter",
    });
  }
  return rows.map((row) => ({ factor: 1, ...row }));
}

const toPlace = ({ log, range: [low, high] }, value) =>
  STEPS * (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));

const toValue = ({ log, range: [low, high] }, place) =>
  log ? low * (high / low) ** (place / STEPS) : low + ((high - low) * place) / STEPS;

/**
 * Fill a container with controls; `changed(name, value)` is called with SI values.
 *
 * Gives `show(values)`, which sets all controls without calling back.
 */
export const controls = (container, start, window, unit, changed) =>
  sliders(container, table(start, window, unit), changed);

/** The same of rows {name, label, unit, factor, log, range, infinite}. */
export function sliders(container, rows, changed) {
  const shows = rows.map((row) => control(container, row, changed));
  return (values) => shows.forEach((show) => show(values));
}

function control(container, row, changed) {
  const id = `control-${row.name}`;
  const line = element("div", { className: "control" });
  const words = row.unit ? `${row.label} [${row.unit}]` : row.label;
  const label = element("label", { htmlFor: id, textContent: words });
  const range = element("input", { id, type: "range", min: 0, max: STEPS, step: 1 });
  const number = element("input", { id: `${id}-number`, type: "number", step: "any" });
  number.setAttribute("aria-label", words);
  let infinite = null;
  line.append(label, range, number);
  if (row.infinite) {
    infinite = element("input", { id: `${id}-infinite`, type: "checkbox" });
    const box = element("label", { className: "infinite", htmlFor: infinite.id });
    box.append(infinite, row.infinite);
    line.append(box);
  }
  container.append(line);
  let last = toValue(row, STEPS / 2);
  const give = (value) => changed(row.name, value);
  range.addEventListener("input", () => give(toValue(row, Number(range.value))));
  number.addEventListener("change", () => {
    const value = Number(number.value) / row.factor;
    const allowed = Number.isFinite(value) && (row.log ? value > 0 : value >= row.range[0]);
    if (number.value !== "" && allowed) give(value);
    else number.value = shown(row, last);
  });
  infinite?.addEventListener("change", () => give(infinite.checked ? Infinity : last));
  return (values) => {
    const value = values[row.name];
    if (infinite) infinite.checked = value === Infinity;
    for (const input of [range, number]) input.disabled = value === Infinity;
    if (value !== Infinity) last = value;
    range.value = Math.round(toPlace(row, last));
    range.setAttribute("aria-valuetext", `${short(last * row.factor)} ${row.unit}`);
    if (number.getRootNode().activeElement !== number) number.value = shown(row, last);
  };
}

const shown = (row, value) => Number((value * row.factor).toPrecision(6));

function element(name, properties) {
  return Object.assign(document.createElement(name), properties);
}
