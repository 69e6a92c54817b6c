// Pictures as SVG: a frame with axes, lines and points in it. No style is set here but by classes.

const SPACE = "http://www.w3.org/2000/svg";
const MARGIN = { left: 70, right: 22, top: 10, bottom: 44 };
// Of an axis that goes up: its label and the gaps around its numbers.
const LABEL = 28;

/** An SVG element with attributes and children. */
export function draw(name, attributes = {}, ...children) {
  const element = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** A number with a few digits, as people write it. */
export function short(value, digits = 4) {
  if (value === Infinity) return "∞";
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) {
    const [head, power] = value.toExponential(digits - 1).split("e");
    return `${Number(head)}·10${superscript(Number(power))}`;
  }
  return `${Number(value.toPrecision(digits))}`;
}

const superscript = (power) =>
  [...`${power}`].map((c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)])).join("");

/** About how wide a number is [px]. */
const widthOf = (text) => [...text].reduce((sum, c) => sum + (/[0-9∞]/.test(c) ? 7.6 : 5), 0);

/** Ticks of an axis: powers of ten (and 2 and 5 where there are few), or steps of 1, 2 or 5. */
function ticks([low, high], log, most) {
  if (log) {
    const [from, to] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const heads = high / low < 500 ? [1, 2, 5] : [1];
    const stride = Math.max(1, Math.ceil((to - from) / most));
    const found = [];
    for (let power = from; power <= to; power++) {
      if (power % stride === 0) found.push(...heads.map((head) => head * 10 ** power));
    }
    return found.filter((x) => x >= low * 0.999 && x <= high * 1.001);
  }
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((head) => head * power).find((x) => x >= rough);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++)
    found.push(i * step);
  return found;
}

const scaleOf = ({ domain: [low, high], log }, [from, to]) =>
  log
    ? (value) => from + ((to - from) * Math.log(value / low)) / Math.log(high / low)
    : (value) => from + ((to - from) * (value - low)) / (high - low);

/**
 * Empty an SVG and draw axes: {domain, log, label} each. Gives the scales `x` and `y`, `inside`, a
 * group whose content is clipped to the frame, and `invert` from places to values.
 */
export function frame(svg, { x, y, height }) {
  const width = Math.max(svg.parentElement.clientWidth, 240);
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const [top, bottom] = [MARGIN.top, height - MARGIN.bottom];
  const rows = ticks(y.domain, y.log, Math.max(3, Math.floor((bottom - top) / 45)));
  const widest = Math.max(0, ...rows.map((value) => widthOf(short(value))));
  const [left, right] = [Math.max(MARGIN.left, LABEL + widest), width - MARGIN.right];
  const toX = scaleOf(x, [left, right]);
  const toY = scaleOf(y, [bottom, top]);
  const clip = `${svg.id}-clip`;
  const parts = [
    draw(
      "clipPath",
      { id: clip },
      draw("rect", { x: left, y: top, width: right - left, height: bottom - top }),
    ),
    draw("rect", { class: "ground", x: left, y: top, width: right - left, height: bottom - top }),
  ];
  for (const value of ticks(x.domain, x.log, Math.max(4, Math.floor((right - left) / 80)))) {
    parts.push(
      draw("line", { class: "grid", x1: toX(value), x2: toX(value), y1: top, y2: bottom }),
      draw(
        "text",
        { class: "tick", x: toX(value), y: bottom + 16, "text-anchor": "middle" },
        short(value),
      ),
    );
  }
  for (const value of rows) {
    parts.push(
      draw("line", { class: "grid", x1: left, x2: right, y1: toY(value), y2: toY(value) }),
      draw(
        "text",
        { class: "tick", x: left - 6, y: toY(value) + 4, "text-anchor": "end" },
        short(value),
      ),
    );
  }
  const middle = (top + bottom) / 2;
  parts.push(
    draw(
      "text",
      { class: "label", x: (left + right) / 2, y: height - 8, "text-anchor": "middle" },
      x.label,
    ),
    draw(
      "text",
      {
        class: "label",
        x: 13,
        y: middle,
        "text-anchor": "middle",
        transform: `rotate(-90 13 ${middle})`,
      },
      y.label,
    ),
  );
  const inside = draw("g", { "clip-path": `url(#${clip})` });
  svg.replaceChildren(...parts, inside);
  const invert = (px, py) => {
    const [u, v] = [(px - left) / (right - left), (bottom - py) / (bottom - top)];
    const back = ({ domain: [low, high], log }, t) =>
      log ? low * (high / low) ** t : low + t * (high - low);
    return [back(x, u), back(y, v)];
  };
  return { x: toX, y: toY, inside, invert, left, right, top, bottom };
}

/** A line through points whose places are finite. */
export function line(place, xs, ys, attributes) {
  let path = "";
  let pen = "M";
  xs.forEach((value, i) => {
    const [x, y] = [place.x(value), place.y(ys[i])];
    if (!Number.isFinite(x) || !Number.isFinite(y)) {
      pen = "M";
      return;
    }
    path += `${pen}${x.toFixed(1)} ${Math.min(Math.max(y, -1e5), 1e5).toFixed(1)}`;
    pen = "L";
  });
  const element = draw("path", { d: path, ...attributes });
  place.inside.append(element);
  return element;
}

/** A table of columns [{head, values}] as text; values are numbers or words. */
export function table(caption, columns) {
  const made = document.createElement("table");
  const words = document.createElement("caption");
  words.textContent = caption;
  const head = made.createTHead().insertRow();
  for (const column of columns) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.textContent = column.head;
    head.append(cell);
  }
  const body = made.createTBody();
  columns[0].values.forEach((_, i) => {
    const row = body.insertRow();
    for (const { values } of columns) {
      const value = values[i];
      row.insertCell().textContent = typeof value === "string" ? value : short(value);
    }
  });
  made.prepend(words);
  return made;
}

/** Put tables behind a picture, into its `details`; `tables` makes them when they are seen. */
export function fill(details, tables) {
  const content = details.querySelector("div");
  details.refill = () => content.replaceChildren(...tables());
  if (details.open) details.refill();
}

/** The lines of a list as text. */
export function lines(list, words) {
  list.replaceChildren(
    ...words.map((text) => Object.assign(document.createElement("li"), { textContent: text })),
  );
  list.hidden = words.length === 0;
}
