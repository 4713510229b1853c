// --- rows of a table: a chart and the table, with the selection in the address ---

const { columns, palette, scale, noun, first } = JSON.parse(document.getElementById("data").textContent);
const columnOf = new Map(columns.map((column) => [column.name, column]));
const count = columns[0].cells.length;
const element = (id) => document.getElementById(id);
const MOST_ROWS = 1000; // rows of the table that are drawn
const FEW = palette.length; // distinct whole numbers that are drawn as classes, and names in a line of the legend
const MARGIN = { left: 64, right: 16, top: 10, bottom: 46 };
const HEIGHT = 380;

const usual = { rows: "", sort: "", logx: "", logy: "", ...first };
const state = { ...usual };
let chosen = -1;
let picked = null; // class of the legend that a reader picked; others are faint
const OTHERS = {}; // stands for the classes beyond the last look
const PLAIN = { color: "#8a8f98", shape: 0, hollow: false };

function readAddress() {
  for (const [key, value] of new URLSearchParams(location.hash.slice(1))) {
    if (key in state) state[key] = value;
  }
  for (const key of ["x", "y", "color"]) if (!columnOf.has(state[key])) state[key] = first[key];
}

function writeAddress() {
  const kept = new URLSearchParams();
  for (const [key, value] of Object.entries(state)) if (value !== usual[key]) kept.set(key, value);
  history.replaceState(null, "", `#${kept}`);
}

// --- the selection ---

const textOf = (index) => columns.filter(({ words }) => words).map(({ cells }) => cells[index]).join(" ").toLowerCase();
const texts = Array.from({ length: count }, (_, index) => textOf(index));

function selected() {
  const wanted = state.rows.toLowerCase().split(/\s+/).filter(Boolean);
  const indices = texts.map((_, index) => index).filter((index) => wanted.every((word) => texts[index].includes(word)));
  const column = columnOf.get(state.sort.replace(/^-/, ""));
  if (!column) return indices;
  const sign = state.sort.startsWith("-") ? -1 : 1;
  const isEmpty = (value) => value === null || value === "";
  return indices.sort((i, j) => {
    const [a, b] = [column.cells[i], column.cells[j]];
    if (isEmpty(a) || isEmpty(b)) return isEmpty(a) - isEmpty(b);
    return sign * (column.words ? a.localeCompare(b, "en", { numeric: true }) : a - b);
  });
}

const shownNumber = (value) => (value === null ? "\u2013" : String(Number(value.toPrecision(4))));
const cellText = ({ words, cells }, index) => (words ? cells[index] : shownNumber(cells[index]));

// --- axes and colors ---

// Places of values along an axis: words one beside the other, numbers by size or by its logarithm.
function axisOf(column, indices, isLogarithmic, length) {
  if (column.words) {
    const classes = [...new Set(indices.map((index) => column.cells[index]))].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
    const step = length / Math.max(classes.length, 1);
    const rank = new Map(classes.map((name, place) => [name, place]));
    const jitter = (index) => (((index * 0.618034) % 1) - 0.5) * 0.5;
    return { place: (index) => (rank.get(column.cells[index]) + 0.5 + jitter(index)) * step, ticks: classes.map((name, place) => [(place + 0.5) * step, name]), isUsed: () => true };
  }
  const isUsed = (index) => column.cells[index] !== null && (!isLogarithmic || column.cells[index] > 0);
  const used = indices.filter(isUsed).map((index) => column.cells[index]);
  const scaled = isLogarithmic ? Math.log10 : (value) => value;
  let [low, high] = used.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, -Infinity]).map(scaled);
  if (!used.length) [low, high] = [0, 1];
  if (low === high) [low, high] = isLogarithmic ? [low - 0.5, high + 0.5] : [low - (Math.abs(low) || 1) / 2, high + (Math.abs(high) || 1) / 2];
  if (!isLogarithmic && low > 0 && low < 0.5 * high) low = 0;
  const margin = 0.04 * (high - low);
  if (low !== 0) low -= margin;
  high += margin;
  const position = (value) => ((scaled(value) - low) / (high - low)) * length;
  const values = isLogarithmic ? powers(low, high) : steps(low, high);
  return { place: (index) => position(column.cells[index]), ticks: values.map((value) => [position(value), shownNumber(value)]), isUsed };
}

function steps(low, high) {
  const rough = (high - low) / 6;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const begin = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - begin + 1 }, (_, k) => (begin + k) * step);
}

// Ticks of a logarithmic axis from 10^low to 10^high; those of less than a decade are even steps.
function powers(low, high) {
  if (high - low < 1) return steps(10 ** low, 10 ** high);
  const factors = high - low > 3 ? [1] : [1, 3];
  const decades = Array.from({ length: Math.ceil(high) - Math.floor(low) + 1 }, (_, k) => 10 ** (Math.floor(low) + k));
  return decades.flatMap((decade) => factors.map((factor) => factor * decade)).filter((value) => Math.log10(value) >= low && Math.log10(value) <= high);
}

function mixed(share) {
  const place = share * (scale.length - 1);
  const below = Math.min(Math.floor(place), scale.length - 2);
  const part = (color, k) => parseInt(color.slice(1 + 2 * k, 3 + 2 * k), 16);
  const channels = [0, 1, 2].map((k) => Math.round(part(scale[below], k) + (place - below) * (part(scale[below + 1], k) - part(scale[below], k))));
  return `rgb(${channels.join()})`;
}

// --- marks: color, shape and whether it is filled, so that no two of many classes look alike ---

const GRAY = "#8a8f98"; // rows without a value, and classes beyond the last look
const arms = (turn) => Array.from({ length: 12 }, (_, k) => {
  const [arm, corner] = [Math.floor(k / 3) * 90 + turn, k % 3];
  const [along, beside] = [[0.42, -0.42], [1.3, -0.42], [1.3, 0.42]][corner];
  const [cos, sin] = [Math.cos((arm * Math.PI) / 180), Math.sin((arm * Math.PI) / 180)];
  return [along * cos - beside * sin, along * sin + beside * cos];
});
// Corners about the center at radius 1; a circle has none. The order is that of figures.
const SHAPES = [
  null, [[-0.89, -0.89], [0.89, -0.89], [0.89, 0.89], [-0.89, 0.89]], [[0, -1.25], [1.25, 0], [0, 1.25], [-1.25, 0]],
  [[0, -1.2], [1.2, 0.9], [-1.2, 0.9]], [[0, 1.2], [1.2, -0.9], [-1.2, -0.9]], arms(0), arms(45),
];
const FILLED = palette.length * SHAPES.length; // looks with filled marks; as many are hollow

// The look of the class at a place: the first ones differ in color and in shape.
function lookOf(place) {
  if (place >= 2 * FILLED) return { color: GRAY, shape: 0, hollow: true };
  const turn = Math.floor(place / palette.length);
  return { color: palette[place % palette.length], shape: (place + turn) % SHAPES.length, hollow: place >= FILLED };
}

function markOf({ color, shape, hollow }, x, y, r) {
  const corners = SHAPES[shape];
  const at = (length) => Number(length.toFixed(2));
  const d = corners ? `M${corners.map((corner) => corner.map((part) => at(part * r)).join()).join("L")}Z` : `M${-r},0a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0Z`;
  const paint = isInk(color) ? "var(--ink)" : color;
  const mark = svg("path", { class: "dot", d, transform: `translate(${at(x)} ${at(y)})` });
  mark.style.fill = hollow ? "var(--page)" : paint;
  if (hollow) Object.assign(mark.style, { stroke: paint, strokeWidth: 1.6 });
  return mark;
}

// Looks of rows, and what the legend has: classes with a look each, other numbers along a scale.
function looksOf(column, indices) {
  const used = indices.map((index) => column.cells[index]).filter((value) => value !== null);
  const classes = [...new Set(used)].sort((a, b) => (column.words ? a.localeCompare(b, "en", { numeric: true }) : a - b));
  if (column.words || (classes.length <= FEW && classes.every(Number.isInteger))) {
    const rank = new Map(classes.map((value, place) => [value, place]));
    const text = (value) => (column.words ? value || "\u2013" : shownNumber(value));
    const own = classes.slice(0, 2 * FILLED).map((value, place) => [lookOf(place), text(value), value]);
    const others = classes.length - own.length;
    if (others) own.push([lookOf(2 * FILLED), `${others} others`, OTHERS]);
    const classOf = (index) => (rank.get(column.cells[index]) < 2 * FILLED ? column.cells[index] : OTHERS);
    return { look: (index) => (rank.has(column.cells[index]) ? lookOf(rank.get(column.cells[index])) : PLAIN), classes: own, classOf };
  }
  const low = classes[0], high = classes[classes.length - 1];
  const color = (index) => (column.cells[index] === null ? GRAY : mixed((column.cells[index] - low) / (high - low)));
  return { look: (index) => ({ ...PLAIN, color: color(index) }), ends: [low, high], classOf: () => null };
}

// --- drawing ---

function svg(tag, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

// Whether a color of the palette is black, which dark pages show in the color of their text.
const isInk = (color) => color === "#000000";

function drawChart(indices) {
  const width = element("chart").clientWidth;
  const [x, y, color] = ["x", "y", "color"].map((key) => columnOf.get(state[key]));
  const across = axisOf(x, indices, state.logx === "1" && !x.words, width - MARGIN.left - MARGIN.right);
  const up = axisOf(y, indices, state.logy === "1" && !y.words, HEIGHT - MARGIN.top - MARGIN.bottom);
  const { look, classes, ends, classOf } = looksOf(color, indices);
  const root = svg("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, height: HEIGHT, role: "img", "aria-label": `${y.heading} against ${x.heading}` });
  const floor = HEIGHT - MARGIN.bottom;
  const most = Math.max(1, Math.floor((width - MARGIN.left - MARGIN.right) / 90));
  const every = Math.ceil(across.ticks.length / most);
  const letters = Math.max(6, Math.floor(((width - MARGIN.left - MARGIN.right) / across.ticks.length) * every / 8));
  across.ticks.forEach(([place, text], k) => {
    if (k % every) return;
    root.append(svg("line", { class: "grid", x1: MARGIN.left + place, x2: MARGIN.left + place, y1: MARGIN.top, y2: floor }));
    const short = text.length > letters ? `${text.slice(0, letters - 1)}\u2026` : text;
    root.append(svg("text", { x: MARGIN.left + place, y: floor + 17, "text-anchor": "middle" }, short));
  });
  for (const [place, text] of up.ticks) {
    root.append(svg("line", { class: "grid", x1: MARGIN.left, x2: width - MARGIN.right, y1: floor - place, y2: floor - place }));
    root.append(svg("text", { x: MARGIN.left - 7, y: floor - place + 4, "text-anchor": "end" }, text.length > 8 ? `${text.slice(0, 7)}\u2026` : text));
  }
  root.append(svg("text", { x: (MARGIN.left + width) / 2, y: HEIGHT - 6, "text-anchor": "middle", "font-weight": 600 }, x.heading));
  root.append(svg("text", { transform: `translate(13 ${floor / 2}) rotate(-90)`, "text-anchor": "middle", "font-weight": 600 }, y.heading));
  const drawn = indices.filter((index) => across.isUsed(index) && up.isUsed(index));
  for (const index of drawn) {
    const dot = markOf(look(index), MARGIN.left + across.place(index), floor - up.place(index), drawn.length > 2000 ? 2.5 : 4);
    if (index === chosen) dot.classList.add("chosen");
    dot.dataset.index = index;
    root.append(dot);
  }
  element("chart").replaceChildren(root);
  const emphasize = (value) => {
    for (const dot of root.querySelectorAll(".dot")) dot.classList.toggle("faint", value !== null && classOf(Number(dot.dataset.index)) !== value);
    root.append(...root.querySelectorAll(".dot:not(.faint)")); // above the faint ones
  };
  if (!classes?.some(([, , value]) => value === picked)) picked = null;
  const entries = ends ? [legendScale(ends)] : classes.map((entry) => legendEntry(...entry, emphasize));
  const heading = document.createElement("b");
  heading.textContent = color.heading;
  element("legend").classList.toggle("many", entries.length > FEW);
  element("legend").replaceChildren(heading, ...entries);
  if (picked !== null) emphasize(picked);
  const missing = indices.length - drawn.length;
  element("matches").textContent = `${indices.length} of ${count}${missing ? `, ${missing} without a value to draw` : ""}`;
}

// A class in the legend: to point at it makes other marks faint, and a click does so until the next.
function legendEntry(look, text, value, emphasize) {
  const entry = document.createElement("button"), key = svg("svg", { width: 13, height: 13, viewBox: "-6.5 -6.5 13 13", "aria-hidden": "true" });
  entry.type = "button";
  key.append(markOf(look, 0, 0, 4));
  entry.append(key, text);
  entry.setAttribute("aria-pressed", picked === value);
  entry.addEventListener("pointerenter", () => emphasize(value));
  entry.addEventListener("pointerleave", () => emphasize(picked));
  entry.addEventListener("click", () => {
    picked = picked === value ? null : value;
    for (const other of element("legend").children) other.setAttribute("aria-pressed", other === entry && picked !== null);
    emphasize(picked);
  });
  return entry;
}

function legendScale([low, high]) {
  const entry = document.createElement("span"), key = document.createElement("i");
  key.className = "scale";
  key.style.background = `linear-gradient(90deg, ${scale.join()})`;
  entry.append(`${shownNumber(low)} `, key, shownNumber(high));
  return entry;
}

const shownColumns = () => state.columns.split(" ").map((name) => columnOf.get(name)).filter(Boolean);

function drawTable(indices) {
  const shown = shownColumns();
  const heads = shown.map((column) => {
    const head = document.createElement("th"), button = document.createElement("button");
    head.scope = "col";
    if (column.words) head.className = "text";
    if (state.sort.replace(/^-/, "") === column.name) head.setAttribute("aria-sort", state.sort.startsWith("-") ? "descending" : "ascending");
    button.type = "button";
    button.textContent = column.heading;
    button.title = column.meaning;
    button.addEventListener("click", () => choose("sort", state.sort === column.name ? `-${column.name}` : column.name));
    head.append(button);
    return head;
  });
  document.querySelector("thead tr").replaceChildren(...heads);
  const rows = indices.slice(0, MOST_ROWS).map((index) => {
    const row = document.createElement("tr");
    row.dataset.index = index;
    if (index === chosen) row.className = "chosen";
    row.append(...shown.map((column) => {
      const cell = document.createElement("td");
      if (column.words) cell.className = "text";
      cell.textContent = cellText(column, index);
      return cell;
    }));
    return row;
  });
  document.querySelector("tbody").replaceChildren(...rows);
  element("cut").textContent = indices.length > MOST_ROWS ? `The table shows the first ${MOST_ROWS} of ${indices.length} ${noun}.` : "";
}

function draw() {
  const indices = selected();
  drawChart(indices);
  drawTable(indices);
}

function choose(key, value) {
  state[key] = value;
  writeAddress();
  draw();
}

// --- controls ---

const CHOICES = ["x", "y", "color"];
const SWITCHES = ["logx", "logy"];

function showState() {
  for (const key of [...CHOICES, "rows"]) element(key).value = state[key];
  for (const key of SWITCHES) element(key).checked = state[key] === "1";
  const names = new Set(state.columns.split(" "));
  for (const box of document.querySelectorAll("#columns input")) box.checked = names.has(box.value);
}

for (const key of CHOICES) {
  element(key).append(...columns.map((column) => new Option(column.heading, column.name)));
  element(key).addEventListener("change", ({ target }) => choose(key, target.value));
}
for (const key of SWITCHES) element(key).addEventListener("change", ({ target }) => choose(key, target.checked ? "1" : ""));
element("rows").addEventListener("input", ({ target }) => choose("rows", target.value));
document.querySelector("#columns p").append(...columns.map((column) => {
  const label = document.createElement("label"), box = document.createElement("input");
  box.type = "checkbox";
  box.value = column.name;
  label.title = column.meaning;
  label.append(box, ` ${column.heading}`);
  box.addEventListener("change", () => {
    const boxes = [...document.querySelectorAll("#columns input:checked")];
    choose("columns", boxes.map(({ value }) => value).join(" "));
  });
  return label;
}));

const described = (index) => columns.filter(({ words, name }) => words || [state.x, state.y, state.color].includes(name))
  .filter((column) => cellText(column, index)).map((column) => `${column.heading} ${cellText(column, index)}`).join(", ");

element("chart").addEventListener("pointerover", ({ target }) => {
  if (target.dataset.index) element("pointed").textContent = described(Number(target.dataset.index));
});
element("chart").addEventListener("click", ({ target }) => {
  if (!target.dataset.index) return;
  chosen = Number(target.dataset.index);
  draw();
  document.querySelector("tr.chosen")?.scrollIntoView({ block: "nearest" });
});
document.querySelector("tbody").addEventListener("click", ({ target }) => {
  chosen = Number(target.closest("tr").dataset.index);
  draw();
});

element("csv").addEventListener("click", ({ target }) => {
  const quoted = (text) => `"${notComputed(text).replaceAll('"', '""')}"`;
  const shown = shownColumns();
  const lines = selected().map((index) => shown.map(({ words, cells }) => (words ? quoted(cells[index]) : cells[index] ?? "")).join());
  const text = [shown.map(({ name }) => quoted(name)).join(), ...lines].join("\n");
  target.href = `data:text/csv;charset=utf-8,${encodeURIComponent(`${text}\n`)}`;
});

function start() {
  readAddress();
  showState();
  draw();
}

addEventListener("hashchange", start);
addEventListener("resize", () => drawChart(selected()));
start();
