// The report of a simulation: one joint of one loop over time.

import { fill, frame, line, short, table } from "./chart.js";
import { spanOf } from "./log_view.js";

const ROWS = 60;
const HEIGHT = 240;

/** Start the part with its data, in the document. */
export function start(data, host) {
  const by = (id) => host.getElementById(id);

  function redraw() {
    const loop = data.loops[by("run-loop").value];
    const { time, setpoint, position, velocity, force } = loop.joints[by("run-joint").value];
    const x = { domain: [0, time[time.length - 1]], log: false, label: "time [s]" };
    const picture = (name, ...signals) => {
      const y = { domain: spanOf(signals.flat()), log: false, label: `${name} [${data.units[name]}]` };
      return frame(by(`run-${name}`), { x, y, height: HEIGHT });
    };
    const above = picture("position", setpoint, position);
    line(above, time, setpoint, { class: "measured" });
    line(above, time, position, { class: "sampled" });
    line(picture("velocity", velocity), time, velocity, { class: "sampled" });
    line(picture("force", force), time, force, { class: "sampled" });
    const largest = Math.max(...position.map((value, i) => Math.abs(value - setpoint[i])));
    by("run-verdict").textContent =
      `${loop.name}: ${loop.verdict}. ${data.joints[by("run-joint").value]} is at most ` +
      `${short(largest, 3)} ${data.units.position} from its setpoint, as far as it is drawn.`;
    by("run-verdict").dataset.stable = loop.verdict === "stable";
    const stride = Math.max(1, Math.ceil(time.length / ROWS));
    const every = (values) => values.filter((_, i) => i % stride === 0);
    fill(by("run-data"), () => [
      table("One joint over time", [
        { head: "time [s]", values: every(time) },
        ...Object.entries({ setpoint, position, velocity, force }).map(([name, values]) => ({
          head: `${name} [${data.units[name]}]`,
          values: every(values),
        })),
      ]),
    ]);
  }

  data.loops.forEach(({ name, verdict }, i) =>
    by("run-loop").append(new Option(`${name} (${verdict})`, i)),
  );
  data.joints.forEach((name, i) => by("run-joint").append(new Option(name, i)));
  for (const id of ["run-loop", "run-joint"]) by(id).addEventListener("change", redraw);
  new ResizeObserver(redraw).observe(by("run-position").parentElement);
  redraw();
}
