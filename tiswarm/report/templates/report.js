"use strict";

// --- table of cases: sorting and filtering ---

for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  const key = (row, column) => {
    const cell = row.cells[column];
    return cell.className === "text" || !cell.textContent ? cell.textContent : Number(cell.textContent);
  };
  const compare = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1; // numbers before words and empty cells
  };
  heads.forEach((head, column) => head.firstChild.addEventListener("click", () => {
    const way = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", way > 0 ? "ascending" : "descending");
    const rows = [...body.rows].sort((a, b) => way * compare(key(a, column), key(b, column)));
    body.append(...rows);
  }));
  const filter = document.getElementById("filter");
  filter.addEventListener("input", () => {
    const words = filter.value.toLowerCase().split(/\s+/);
    let shown = 0;
    for (const row of body.rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      shown += !row.hidden;
    }
    document.getElementById("matches").textContent = `${shown} of ${body.rows.length}`;
  });
}

// --- 3D view of true and estimated positions ---

const BLACK = [0, 0, 0], WHITE = [255, 255, 255];
const SOLID = 3000; // most robots that are drawn with docks and arms
const SHADES = 48; // number of colors of the error scale
const NEARBY = 12; // distance within which the pointer selects a robot [pixels]
const SIDES = [0, 1, 2]; // x, y, z
const START = { turn: -1.0, tilt: 0.22, zoom: 1 };

const rgb = (color) => `rgb(${color.map(Math.round).join(" ")})`;
const mixed = (a, b, share) => a.map((value, k) => value + share * (b[k] - value));

// The colors of a CSS variable such as --errors: #fcf0c3, #8c0d2f.
function colorsOf(variable) {
  const text = getComputedStyle(document.documentElement).getPropertyValue(variable);
  return text.split(",").map((color) => [1, 3, 5].map((k) => parseInt(color.trim().slice(k, k + 2), 16)));
}

const ERROR_COLORS = colorsOf("--errors"), [TRUE_COLOR] = colorsOf("--true");
const ESTIMATE_ARM = mixed(colorsOf("--estimate")[0], BLACK, 0.3);

function errorColor(share) {
  const place = share * (ERROR_COLORS.length - 1), n = Math.min(Math.floor(place), ERROR_COLORS.length - 2);
  return mixed(ERROR_COLORS[n], ERROR_COLORS[n + 1], place - n);
}

// A ball lit from the upper left.
function ball(color) {
  const picture = new OffscreenCanvas(64, 64), pen = picture.getContext("2d");
  const light = pen.createRadialGradient(23, 20, 2, 32, 32, 32);
  light.addColorStop(0, rgb(mixed(color, WHITE, 0.5)));
  light.addColorStop(0.5, rgb(color));
  light.addColorStop(1, rgb(mixed(color, BLACK, 0.45)));
  pen.fillStyle = light;
  pen.arc(32, 32, 31, 0, 7);
  pen.fill();
  return picture;
}

// The docks of a robot: its center plus each offset, rotated by a quaternion (w, x, y, z).
function docksOf([x, y, z], [w, a, b, c], offsets) {
  return offsets.map(([u, v, s]) => {
    const p = 2 * (b * s - c * v), q = 2 * (c * u - a * s), r = 2 * (a * v - b * u);
    return [x + u + w * p + b * r - c * q, y + v + w * q + c * p - a * r, z + s + w * r + a * q - b * p];
  });
}

// The box around all robots, and ticks along its sides [R].
function boxOf(shown) {
  const reach = 3; // a robot's docks lie within this
  const low = SIDES.map((k) => shown.true.concat(shown.estimate).reduce((m, p) => Math.min(m, p[k]), Infinity) - reach);
  const high = SIDES.map((k) => shown.true.concat(shown.estimate).reduce((m, p) => Math.max(m, p[k]), -Infinity) + reach);
  const middle = mixed(low, high, 0.5), radius = Math.hypot(...low.map((l, k) => high[k] - l)) / 2;
  const power = 10 ** Math.floor(Math.log10(radius / 2));
  const step = [1, 2, 5, 10].find((times) => times * power >= radius / 3) * power;
  const ticks = SIDES.map((k) => {
    const first = Math.ceil(low[k] / step);
    return Array.from({ length: Math.floor(high[k] / step) - first + 1 }, (_, n) => (first + n) * step);
  });
  return { low, high, middle, radius, ticks };
}

// Projects points onto the canvas: x, y, pixels per R, nearness.
function cameraOf(box, { turn, tilt, zoom }, fit, width, height) {
  const [ct, st, ce, se] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const eye = [ce * ct, ce * st, se], away = 4 * box.radius;
  const place = (point) => {
    const [x, y, z] = point.map((value, k) => value - box.middle[k]);
    const near = eye[0] * x + eye[1] * y + eye[2] * z;
    const scale = (zoom * fit * away) / Math.max(away - near, 0.05 * away);
    return [width / 2 + scale * (ct * y - st * x), height / 2 - scale * (ce * z - se * (ct * x + st * y)), scale, near];
  };
  return { eye, place };
}

// Pixels per R at which the whole box fits the canvas.
function fitOf(box, width, height) {
  const { place } = cameraOf(box, START, 1, 0, 0);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((n) => place(SIDES.map((k) => (n >> k & 1 ? box.high : box.low)[k])));
  const reach = (k) => Math.max(...corners.map((corner) => Math.abs(corner[k])));
  return Math.min((width / 2 - 90) / reach(0), (height / 2 - 40) / reach(1));
}

// The far sides of the box with a grid, and numbers along visible edges.
function drawBox(pen, box, { eye, place }) {
  const far = SIDES.map((k) => (eye[k] > 0 ? box.low : box.high)[k]);
  const near = SIDES.map((k) => (eye[k] > 0 ? box.high : box.low)[k]);
  const at = (k, value, others) => SIDES.map((n) => (n === k ? value : others[n]));
  const line = (from, to) => { pen.moveTo(...place(from).slice(0, 2)); pen.lineTo(...place(to).slice(0, 2)); };
  pen.beginPath();
  for (const k of SIDES) for (const tick of [box.low[k], ...box.ticks[k], box.high[k]]) {
    for (const m of SIDES.filter((other) => other !== k)) {
      line(at(m, box.low[m], at(k, tick, far)), at(m, box.high[m], at(k, tick, far)));
    }
  }
  pen.strokeStyle = "#dde2e8";
  pen.lineWidth = 1;
  pen.stroke();
  const upright = [[near[0], far[1], far[2]], [far[0], near[1], far[2]]].sort((a, b) => place(a)[0] - place(b)[0])[0];
  const edges = [[far[0], near[1], far[2]], [near[0], far[1], far[2]], upright];
  const [x, y] = place(box.middle);
  pen.fillStyle = "#1c2430";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const k of SIDES) {
    const write = (text, point, gap) => {
      const [px, py] = place(point), away = Math.hypot(px - x, py - y) || 1;
      const [dx, dy] = k === 2 ? [-1, 0] : [(px - x) / away, (py - y) / away];
      pen.fillText(text, px + gap * dx, py + gap * dy);
    };
    pen.font = "12px system-ui, sans-serif";
    for (const tick of box.ticks[k]) write(String(tick), at(k, tick, edges[k]), 16);
    pen.font = "600 13px system-ui, sans-serif";
    write(`${"xyz"[k]} [R]`, at(k, box.middle[k], edges[k]), 44);
  }
}

// The color scale of errors.
function drawScale(pen, worst, width) {
  const [left, top, wide, tall] = [width - 62, 44, 14, 220];
  const colors = pen.createLinearGradient(0, top + tall, 0, top);
  ERROR_COLORS.forEach((color, n) => colors.addColorStop(n / (ERROR_COLORS.length - 1), rgb(color)));
  pen.fillStyle = colors;
  pen.fillRect(left, top, wide, tall);
  pen.fillStyle = "#1c2430";
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  pen.font = "600 13px system-ui, sans-serif";
  pen.fillText("error [R]", left - 12, top - 20);
  pen.font = "12px system-ui, sans-serif";
  for (const share of [0, 0.25, 0.5, 0.75, 1]) pen.fillText((share * worst).toPrecision(2), left + wide + 6, top + tall * (1 - share));
}

// The shapes of robots and errors, the farthest first.
function shapesOf(shown, count, offsets, wanted, place, balls) {
  const shapes = [];
  const robots = (poses, turns, radius, armColor, ballOf) => poses.slice(0, count).forEach((center, n) => {
    const middle = place(center), docks = shown.robot.length > SOLID ? [] : docksOf(center, turns[n], offsets);
    for (const dock of docks.map(place)) {
      shapes.push({ near: (middle[3] + dock[3]) / 2, from: middle, to: dock, color: armColor, wide: 0.3 * middle[2] });
      shapes.push({ near: dock[3], from: dock, ball: ballOf(n), radius: radius * dock[2] });
    }
    if (!docks.length) shapes.push({ near: middle[3], from: middle, ball: ballOf(n), radius: Math.max(1.5, middle[2]) });
  });
  if (wanted.truth) robots(shown.true, shown.turn, 0.78, rgb(TRUE_COLOR), () => balls.truth);
  if (wanted.estimate) {
    const shade = (n) => balls.errors[Math.round((SHADES - 1) * Math.min(1, shown.error[n] / shown.worst))];
    robots(shown.estimate, shown.sensed, 0.66, rgb(ESTIMATE_ARM), shade);
  }
  for (let n = 0; wanted.error && n < count; n++) {
    const [from, to] = [place(shown.true[n]), place(shown.estimate[n])];
    shapes.push({ near: (from[3] + to[3]) / 2, from, to, color: "#222", wide: 1.5 });
  }
  return shapes.sort((a, b) => a.near - b.near);
}

function drawShape(pen, { from, to, color, wide, ball: picture, radius }) {
  if (picture) {
    pen.drawImage(picture, from[0] - radius, from[1] - radius, 2 * radius, 2 * radius);
    return;
  }
  pen.strokeStyle = color;
  pen.lineWidth = wide;
  pen.beginPath();
  pen.moveTo(from[0], from[1]);
  pen.lineTo(to[0], to[1]);
  pen.stroke();
}

function showSpace(view) {
  const data = JSON.parse(document.getElementById("data").textContent);
  const [picker, slider, joined] = ["case", "joins", "joined"].map((id) => document.getElementById(id));
  const boxes = ["truth", "estimate", "error"].map((id) => [id, document.getElementById(`show-${id}`)]);
  const pointed = document.getElementById("pointed"), pen = view.getContext("2d");
  const shades = Array.from({ length: SHADES }, (_, n) => ball(errorColor(n / (SHADES - 1))));
  const balls = { truth: ball(TRUE_COLOR), errors: shades };
  let look = { ...START }, shown, box, place, due = 0;
  data.cases.forEach((each, n) => picker.add(new Option(each.name, n)));

  const draw = () => {
    due = 0;
    const [width, height, dense] = [view.clientWidth, view.clientHeight, devicePixelRatio];
    view.width = width * dense;
    view.height = height * dense;
    pen.scale(dense, dense);
    pen.lineCap = "round";
    const wanted = Object.fromEntries(boxes.map(([id, check]) => [id, check.checked]));
    const camera = cameraOf(box, look, fitOf(box, width, height), width, height);
    place = camera.place;
    drawBox(pen, box, camera);
    shapesOf(shown, slider.value, data.offsets, wanted, place, balls).forEach((shape) => drawShape(pen, shape));
    if (wanted.estimate) drawScale(pen, shown.worst, width);
    joined.textContent = `${slider.value} of ${shown.robot.length}`;
  };
  const soon = () => { due ||= requestAnimationFrame(draw); };
  const choose = () => {
    shown = data.cases[picker.value];
    box = boxOf(shown);
    look = { ...START };
    slider.max = shown.robot.length; // before the value, which it bounds
    slider.value = slider.max;
    draw();
  };
  // The robot whose true or estimated center is nearest to the pointer.
  const point = ({ offsetX, offsetY }) => {
    let found = -1, nearest = NEARBY;
    for (let n = 0; n < slider.value; n++) for (const poses of [shown.true, shown.estimate]) {
      const [x, y] = place(poses[n]), distance = Math.hypot(x - offsetX, y - offsetY);
      if (distance < nearest) [found, nearest] = [n, distance];
    }
    pointed.textContent = found < 0 ? "" : `Robot ${shown.robot[found]}, join index ${found}: error ${shown.error[found]} R.`;
  };
  view.addEventListener("pointerdown", (event) => view.setPointerCapture(event.pointerId));
  view.addEventListener("pointermove", (event) => {
    if (!event.buttons) { point(event); return; }
    look.turn -= 0.008 * event.movementX;
    look.tilt = Math.max(-1.57, Math.min(1.57, look.tilt + 0.008 * event.movementY));
    soon();
  });
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    look.zoom *= Math.exp(-0.001 * event.deltaY);
    soon();
  }, { passive: false });
  view.addEventListener("dblclick", () => { look = { ...START }; soon(); });
  picker.addEventListener("change", choose);
  slider.addEventListener("input", soon);
  boxes.forEach(([, check]) => check.addEventListener("change", soon));
  choose();
  new ResizeObserver(soon).observe(view);
}

const view = document.getElementById("view");
if (view) showSpace(view);
