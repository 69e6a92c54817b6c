// What was asked of tuned gains, and what holds.

import { table } from "./chart.js";

/** Say whether they are certified; `data` {sentence, certified}. */
export function showSentence(paragraph, { sentence, certified }) {
  paragraph.textContent = `${certified ? "Certified" : "NOT certified"}: ${sentence}.`;
  paragraph.dataset.stable = certified;
}

/** Every constraint with what it is at its worst, and in which of the members. */
export function checkTable({ checks, members }) {
  const column = (head, value) => ({ head, values: checks.map(value) });
  const said = (metric) => metric.replaceAll("_", " ");
  return table(`What was asked of ${members === 1 ? "the loop" : `all ${members} members`}`, [
    column("metric", ({ metric }) => said(metric)),
    column("bound", ({ bound }) => bound),
    column("at its worst", ({ value }) => value),
    column("of", ({ member }) => member),
    column("holds", ({ met }) => (met ? "yes" : "NO")),
  ]);
}
