// --- 3D view of true and estimated positions ---

const BLACK = [0, 0, 0], WHITE = [255, 255, 255], UNKNOWN_COLOR = [154, 163, 173];
const SOLID = 3000; // most robots that are drawn with docks and arms, and without WebGL
const PAINTED = 10000; // most robots that are drawn where the browser has no WebGL
const SHADES = 50; // number of colors of a scale: 7 from each of 8 labels to the next
const NEARBY = 12; // distance within which the pointer selects a robot [pixels]
const SIDES = [0, 1, 2]; // x, y, z
const START = { turn: -1.0, tilt: 0.22, zoom: 1, right: 0, down: 0 }; // the last two in pixels
const GHOST = { opacity: 0.25, gap: 0.3, back: 1 }; // of true robots beside estimated ones: opacity; error from which they are drawn, and how much they are drawn behind their place [R]
const ROOM = { above: 70, below: 84, side: 36 }; // around the box, for the title, numbers and labels [pixels]
const EARTH = 0.75; // opacity of the ground
const SPHERE = 0.3; // opacity of spheres
const RAISED = 1.5; // contacts are drawn as if they were this much nearer [R]

const rgb = (color) => `rgb(${color.map(Math.round).join(" ")})`;
const mixed = (a, b, share) => a.map((value, k) => value + share * (b[k] - value));
const minus = (a, b) => a.map((value, k) => value - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const short = (value) => String(Number(value.toPrecision(3)));

// The text of a CSS variable, and the colors of one such as --errors: #fcf0c3, #8c0d2f.
const textOf = (variable) => getComputedStyle(document.documentElement).getPropertyValue(variable).trim();
const colorsOf = (variable) => textOf(variable).split(",").map((color) => [1, 3, 5].map((k) => parseInt(color.trim().slice(k, k + 2), 16)));

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

// The color at a share of a scale.
function along(colors, share) {
  const place = Math.min(1, share) * (colors.length - 1), k = Math.min(Math.floor(place), colors.length - 2);
  return mixed(colors[k], colors[k + 1], place - k);
}

// The share of a scale at which a value lies, 0 to 1.
function shareOf({ least, most, logarithmic }, value) {
  const share = logarithmic ? Math.log(value / least) / Math.log(most / least) : (value - least) / (most - least || 1);
  return Math.max(0, Math.min(1, share));
}

// The values along a scale that its legend states: 1, 2, 5, 10, ... where it is logarithmic, or else both ends and the middle.
function marksOf({ least, most, logarithmic }) {
  if (!logarithmic) return [0, 0.5, 1].map((share) => least + share * (most - least || 1));
  const powers = Array.from({ length: Math.ceil(Math.log10(most / least)) + 1 }, (_, n) => 10 ** (Math.floor(Math.log10(least)) + n));
  return powers.flatMap((power) => [power, 2 * power, 5 * power]).filter((value) => value >= least && value <= most);
}

// Balls in the colors of a scale.
function shadesOf(colors) {
  return Array.from({ length: SHADES }, (_, n) => ball(along(colors, n / (SHADES - 1))));
}

// The docks of a robot: its center plus each offset, rotated by a quaternion (w, x, y, z).
function docksOf([x, y, z], [w, a, b, c], offsets) {
  return offsets.map(([u, v, s]) => {
    const p = 2 * (b * s - c * v), q = 2 * (c * u - a * s), r = 2 * (a * v - b * u);
    return [x + u + w * p + b * r - c * q, y + v + w * q + c * p - a * r, z + s + w * r + a * q - b * p];
  });
}

// The box around all robots and the ground of cases, and ticks along its sides [R]; `scale` is R in the unit of their labels.
function boxOf(cases, scale) {
  const reach = 2.6; // a robot's docks lie within this
  const low = [Infinity, Infinity, Infinity], high = low.map((value) => -value);
  const grow = (point, room) => SIDES.forEach((k) => {
    low[k] = Math.min(low[k], point[k] - room);
    high[k] = Math.max(high[k], point[k] + room);
  });
  for (const { true: truth, estimate, ground } of cases) {
    truth.concat(estimate).forEach((point) => grow(point, reach));
    ground.flat(2).forEach((point) => grow(point, 0));
  }
  const middle = mixed(low, high, 0.5), radius = Math.hypot(...minus(high, low)) / 2;
  const power = 10 ** Math.floor(Math.log10(radius * scale / 2));
  const step = [1, 2, 5, 10].find((times) => times * power >= radius * scale / 3) * power / scale;
  const ticks = SIDES.map((k) => {
    const first = Math.ceil(low[k] / step);
    return Array.from({ length: Math.floor(high[k] / step) - first + 1 }, (_, n) => (first + n) * step);
  });
  return { low, high, middle, radius, ticks };
}

// Projects points onto the canvas: x, y, pixels per R, nearness.
function cameraOf(box, { turn, tilt, zoom, right, down }, fit, width, height) {
  const [ct, st, ce, se] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const toward = [ce * ct, ce * st, se], away = 4 * box.radius;
  const place = (point) => {
    const [x, y, z] = minus(point, box.middle);
    const near = dot(toward, [x, y, z]), scale = (zoom * fit * away) / Math.max(away - near, 0.05 * away);
    return [width / 2 + right + scale * (ct * y - st * x), height / 2 + down - scale * (ce * z - se * (ct * x + st * y)), scale, near];
  };
  return { look: { turn, tilt, zoom, right, down }, fit, radius: box.radius, toward, eye: box.middle.map((value, k) => value + away * toward[k]), place };
}

// Pixels per R, and shift of the middle, at which the whole box fits the canvas.
function fitOf(box, width, height) {
  const { place } = cameraOf(box, START, 1, 0, 0);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((n) => place(SIDES.map((k) => (n >> k & 1 ? box.high : box.low)[k])));
  const span = [0, 1].map((k) => [Math.min, Math.max].map((end) => end(...corners.map((corner) => corner[k]))));
  const side = Math.min(ROOM.side, width / 7), room = [width - 2 * side, height - ROOM.above - ROOM.below];
  const fit = Math.min(...span.map(([low, high], k) => room[k] / (high - low)));
  const [right, down] = span.map(([low, high]) => -fit * (low + high) / 2);
  return { fit, right, down: down + (ROOM.above - ROOM.below) / 2 };
}

// The far sides of the box with a grid, and numbers along visible edges.
function drawBox(pen, box, { radius, unit }, { toward, place }) {
  const far = SIDES.map((k) => (toward[k] > 0 ? box.low : box.high)[k]);
  const near = SIDES.map((k) => (toward[k] > 0 ? box.high : box.low)[k]);
  const at = (k, value, others) => SIDES.map((n) => (n === k ? value : others[n]));
  const line = (from, to) => { pen.moveTo(...place(from).slice(0, 2)); pen.lineTo(...place(to).slice(0, 2)); };
  pen.beginPath();
  for (const k of SIDES) for (const tick of [box.low[k], ...box.ticks[k], box.high[k]]) {
    for (const m of SIDES.filter((other) => other !== k)) {
      line(at(m, box.low[m], at(k, tick, far)), at(m, box.high[m], at(k, tick, far)));
    }
  }
  pen.strokeStyle = textOf("--rule");
  pen.lineWidth = 1;
  pen.stroke();
  const upright = [[near[0], far[1], far[2]], [far[0], near[1], far[2]]].sort((a, b) => place(a)[0] - place(b)[0])[0];
  const edges = [[far[0], near[1], far[2]], [near[0], far[1], far[2]], upright];
  const [x, y] = place(box.middle);
  pen.fillStyle = textOf("--ink");
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const k of SIDES) {
    const write = (text, [px, py], gap, way = null) => {
      const away = Math.hypot(px - x, py - y) || 1;
      const [dx, dy] = way || [(px - x) / away, (py - y) / away];
      pen.fillText(text, Math.max(px + gap * dx, pen.measureText(text).width / 2 + 2), py + gap * dy);
    };
    pen.font = "12px system-ui, sans-serif";
    for (const tick of box.ticks[k]) write(String(Number((tick * radius).toPrecision(9))), place(at(k, tick, edges[k])), 16, k === 2 ? [-1, 0] : null);
    pen.font = "600 13px system-ui, sans-serif";
    const label = `${"xyz"[k]} [${unit}]`;
    if (k === 2) write(label, place(at(k, box.high[k], edges[k])).slice(0, 2), 16, [-1, -1]);
    else write(label, place(at(k, box.middle[k], edges[k])), 42);
  }
}

// The color scale of the estimate, or its labels, and what gray means.
function drawScale(pen, legend, width, height) {
  const { label, unit, least, most, scale, words, value, meaning, gray, isCapped } = legend;
  const [wide, tall, right] = [Math.min(180, width / 2), 10, width - 22], [left, top] = [right - wide, height - 34];
  const small = "12px system-ui, sans-serif", colors = colorsOf(scale);
  const keys = [...words.map((word, n) => [word, colors[n]]), ...(value.includes(null) ? [[gray, UNKNOWN_COLOR]] : [])];
  const key = ([word, color], x, y) => { pen.fillText(word, x - 18, y); pen.drawImage(ball(color), x - 14, y - 7, 14, 14); };
  pen.fillStyle = textOf("--ink");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.font = small;
  if (words.length) keys.forEach((each, n) => key(each, right, height - 16 - 18 * (keys.length - 1 - n)));
  else keys.forEach((each) => key(each, left - 14, top + 5));
  pen.font = "600 13px system-ui, sans-serif";
  const title = [label, unit && `[${unit}]`, meaning && `(${meaning})`].filter(Boolean).join(" ");
  pen.fillText(title, right, words.length ? height - 16 - 18 * keys.length : top - 12);
  if (words.length) return;
  const bar = pen.createLinearGradient(left, 0, right, 0), span = most - least || 1;
  colors.forEach((color, n, all) => bar.addColorStop(n / (all.length - 1), rgb(color)));
  pen.fillStyle = bar;
  pen.fillRect(left, top, wide, tall);
  pen.fillStyle = textOf("--ink");
  pen.textAlign = "center";
  pen.font = small;
  const digits = (least ? 3 : 2) + Math.floor(Math.log10(Math.max(Math.abs(least), Math.abs(most), span) / span));
  for (const mark of marksOf(legend)) {
    const number = String(Number(mark.toPrecision(Math.min(digits, 12))));
    pen.fillText(isCapped && mark === most ? `≥ ${number}` : number, left + shareOf(legend, mark) * wide, top + tall + 11);
  }
}

// The pieces of ground from the farthest to the nearest: drawn faces, and whether the piece hides a point from the eye.
function groundOf(pieces, { eye, place }) {
  return pieces.map((faces) => {
    const sides = faces.map((corners) => {
      const [a, b, c, d] = corners, [p, q] = [minus(c, a), minus(d, b)];
      const outward = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
      const sign = faces.length > 1 || dot(outward, minus(eye, a)) > 0 ? 1 : -1; // a plane has two sides
      const normal = outward.map((value) => sign * value / Math.hypot(...outward));
      return { corners: corners.map(place), base: a, normal, front: dot(normal, minus(eye, a)) > 0 };
    });
    const seen = sides.filter((side) => side.front);
    const hides = (point) => !seen.some(({ base, normal }) => dot(normal, minus(point, base)) > 0);
    return { seen, hides, near: Math.max(...sides.flatMap((side) => side.corners.map((corner) => corner[3]))) };
  }).sort((a, b) => a.near - b.near);
}

function drawGround(pen, { seen }) {
  const [top, edge] = [colorsOf("--ground")[0], textOf("--rule")];
  pen.globalAlpha = EARTH;
  pen.lineWidth = 1;
  for (const { corners, normal } of seen) {
    pen.beginPath();
    corners.forEach((corner) => pen.lineTo(corner[0], corner[1]));
    pen.closePath();
    pen.fillStyle = pen.strokeStyle = rgb(mixed(top, BLACK, 0.16 * (1 - Math.abs(normal[2]))));
    pen.fill();
    if (seen.length === 1) pen.strokeStyle = edge;
    pen.stroke(); // closes the seams between faces
  }
  pen.globalAlpha = 1;
}

// The shapes of robots, contacts and errors, unsorted; each with its place in space.
function shapesOf(shown, count, offsets, wanted, coloring, place, balls) {
  const shapes = [];
  const put = (point) => Object.assign(place(point), { point });
  const isGhost = (poses) => wanted.estimate && poses === shown.true;
  const robots = (poses, turns, armColor, ballOf) => poses.slice(0, count).forEach((center, n) => {
    if (isGhost(poses) && Math.hypot(...minus(center, shown.estimate[n])) < GHOST.gap) return;
    const [opacity, back] = isGhost(poses) ? [GHOST.opacity, GHOST.back] : [1, 0];
    const middle = put(center), around = docksOf(center, turns[n], offsets);
    if (shown.robot.length > SOLID) {
      shapes.push({ near: middle[3] - back, from: middle, ball: ballOf(n), radius: Math.max(1.5, middle[2]), opacity });
      return;
    }
    for (const dock of around.map(put)) {
      shapes.push({ near: (middle[3] + dock[3]) / 2 - back, from: middle, to: dock, color: armColor, wide: 0.3 * middle[2], opacity });
      shapes.push({ near: dock[3] - back, from: dock, ball: ballOf(n), radius: dock[2], opacity });
    }
  });
  if (wanted.truth) robots(shown.true, shown.turn, textOf("--true"), () => balls.truth);
  if (wanted.estimate) {
    const shades = balls[coloring.scale];
    const shade = (n) => coloring.value[n] === null ? balls.unknown
      : shades[Math.round((SHADES - 1) * shareOf(coloring, coloring.value[n]))];
    robots(shown.estimate, shown.sensed, textOf("--arm"), shade);
  }
  const line = (a, b, color, wide, raised) => {
    const [from, to] = [put(a), put(b)];
    shapes.push({ near: (from[3] + to[3]) / 2 + raised, from, to, color, wide, opacity: 1 });
  };
  for (const [i, a, j, b] of wanted.contacts ? shown.contacts : []) {
    if (Math.max(i, j) >= count) continue;
    const dock = (n, k) => docksOf(shown.estimate[n], shown.sensed[n], offsets)[k];
    line(dock(i, a), dock(j, b), textOf("--contact"), 2.5, RAISED);
  }
  for (let n = 0; wanted.error && n < count; n++) line(shown.true[n], shown.estimate[n], textOf("--ink"), 1.5, 0);
  return shapes;
}

function drawShape(pen, { from, to, color, wide, ball: picture, radius, opacity }) {
  pen.globalAlpha = opacity;
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

// Ground and shapes, the farthest first; a shape that a piece of ground hides is drawn before it.
function drawInOrder(pen, pieces, shapes) {
  const layers = [...pieces, null].map(() => []);
  for (const shape of shapes) {
    const hiding = pieces.findIndex((piece) => piece.hides(shape.from.point));
    layers[hiding < 0 ? pieces.length : hiding].push(shape);
  }
  layers.forEach((layer, n) => {
    layer.sort((a, b) => a.near - b.near).forEach((shape) => drawShape(pen, shape));
    pen.globalAlpha = 1;
    if (n < pieces.length) drawGround(pen, pieces[n]);
  });
}

// Contacts on the shortest way from the first robot to each robot; null where none lead there.
function hopsOf({ robot, contacts }) {
  const touching = robot.map(() => []), hops = robot.map(() => null), reached = [0];
  contacts.forEach(([i, , j]) => { touching[i].push(j); touching[j].push(i); });
  hops[0] = 0;
  for (const n of reached) for (const m of touching[n]) if (hops[m] === null) { hops[m] = hops[n] + 1; reached.push(m); }
  return hops;
}

// The colorings of a case: those of its data, hops, and the order of joining; the last two are counted when they are shown.
function coloringsOf({ colors, robot, contacts }) {
  const given = colors.map((each) => ({
    ...each,
    scale: `--${each.scale}`,
    isCapped: each.most !== null && each.value.some((v) => v > each.most),
    most: each.most !== null ? each.most : each.words.length ? colorsOf(`--${each.scale}`).length - 1 : each.value.reduce((most, v) => Math.max(most, v ?? most), each.least) || each.least + 1,
  }));
  const counted = (label, count) => {
    let value;
    return { label, unit: "", scale: "--joins", least: 0, words: [], gray: "unknown", get value() { return value ||= count(); }, get most() { return this.value.reduce((most, v) => Math.max(most, v), 1); } };
  };
  return [...given, counted("hops from the first robot", () => hopsOf({ robot, contacts })), counted("join index", () => robot.map((_, n) => n))];
}

// Radii of a case's spheres [R], 0 where the standard deviation is unknown; undefined where no robot has one.
function spheresOf({ colors }, { sphere, radius }) {
  return colors.find(({ label }) => label === "sd")?.value.map((sd) => ((sd ?? 0) * sphere) / radius);
}
