// The margins of both loops as a table; every cell also has its number in full, in SI units.

import { short } from "./chart.js";
import { degrees } from "./words.js";

const ROWS = [
  ["growth_rate", "growth rate of a perturbation", "1/s", (x) => x],
  ["root_frequency", "its frequency", "rad/s", (x) => x],
  ["gain_margin", "gain margin: both gains may rise by", "×", (x) => x],
  ["gain_reduction_margin", "and fall to", "×", (x) => x],
  ["phase_crossover", "phase crossover", "rad/s", (x) => x],
  ["phase_margin", "phase margin", "°", degrees],
  ["gain_crossover", "gain crossover", "rad/s", (x) => x],
  ["delay_margin", "delay margin", "ms", (x) => 1000 * x],
  ["sensitivity_peak", "Ms, peak of |S|", "", (x) => x],
  ["sensitivity_peak_frequency", "where", "rad/s", (x) => x],
  ["complementary_peak", "Mt, peak of |T|", "", (x) => x],
  ["complementary_peak_frequency", "where", "rad/s", (x) => x],
  ["modulus_margin", "modulus margin, 1/Ms", "", (x) => x],
  ["disk_margin", "disk margin", "", (x) => x],
];
// What an unstable loop has as well.
const ALWAYS = new Set(["growth_rate", "root_frequency"]);

/** Fill the body of a table with a column for each of `found`: {margins, root} by kind. */
export function showMargins(body, found) {
  const kinds = Object.keys(found);
  const state = row("stable", "is it stable?");
  kinds.forEach((kind) =>
    cell(state, kind, found[kind].margins.stable, found[kind].margins.stable ? "yes" : "NO"),
  );
  const lines = [state];
  for (const [name, label, unit, scale] of ROWS) {
    const made = row(name, unit ? `${label} [${unit}]` : label);
    for (const kind of kinds) {
      const { margins, root } = found[kind];
      const all = { ...margins, growth_rate: root.re, root_frequency: root.im };
      const value = margins.stable || ALWAYS.has(name) ? all[name] : NaN;
      cell(made, kind, value, short(scale(value)));
    }
    lines.push(made);
  }
  body.replaceChildren(...lines);
}

function row(name, label) {
  const made = document.createElement("tr");
  made.dataset.name = name;
  const head = document.createElement("th");
  head.scope = "row";
  head.textContent = label;
  made.append(head);
  return made;
}

function cell(line, kind, value, text) {
  const made = line.insertCell();
  made.dataset.kind = kind;
  made.dataset.value = String(value);
  made.textContent = text;
}
