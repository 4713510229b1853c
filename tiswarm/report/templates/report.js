"use strict";

// --- the table of cases: sort by a column, show some rows ---

for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  const key = (row, column) => {
    const cell = row.cells[column];
    return cell.dataset.value === undefined ? cell.textContent : Number(cell.dataset.value);
  };
  const compare = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1; // numbers before words and gaps
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

// --- truth and estimate in space ---

const ERROR_COLORS = [[0, "#fcf0c3"], [0.35, "#f9b64c"], [0.7, "#e4572e"], [1, "#8c0d2f"]];
const TRUE_COLOR = "#6aa9d8";
const ROUND = 250; // robots that are drawn with finer spheres than more of them
const SOLID = 3000; // robots that are drawn as spheres at all

// Corners and faces of a sphere of radius 1: an icosahedron, its faces cut in four or not.
function sphere(fine) {
  const t = (1 + Math.sqrt(5)) / 2;
  let corners = [[-1, t, 0], [1, t, 0], [-1, -t, 0], [1, -t, 0], [0, -1, t], [0, 1, t],
    [0, -1, -t], [0, 1, -t], [t, 0, -1], [t, 0, 1], [-t, 0, -1], [-t, 0, 1]];
  let faces = [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
    [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9],
    [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]];
  if (fine) {
    const middles = new Map();
    const middle = (a, b) => {
      const name = a < b ? `${a},${b}` : `${b},${a}`;
      if (!middles.has(name)) {
        middles.set(name, corners.length);
        corners.push(corners[a].map((x, k) => x + corners[b][k]));
      }
      return middles.get(name);
    };
    faces = faces.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
      return [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]];
    });
  }
  corners = corners.map((corner) => corner.map((x) => x / Math.hypot(...corner)));
  return { corners, faces };
}

// The docks of a robot: its centre and each offset, turned by a quaternion (w, x, y, z).
function docksOf([x, y, z], [w, a, b, c], offsets) {
  return offsets.map(([u, v, s]) => {
    const p = 2 * (b * s - c * v), q = 2 * (c * u - a * s), r = 2 * (a * v - b * u);
    return [x + u + w * p + b * r - c * q, y + v + w * q + c * p - a * r, z + s + w * r + a * q - b * p];
  });
}

function spheres(docks, radius, ball, look) {
  const mesh = { type: "mesh3d", x: [], y: [], z: [], i: [], j: [], k: [], ...look,
    lighting: { ambient: 0.6, diffuse: 0.6, specular: 0.15, roughness: 0.6, fresnel: 0.1 },
    lightposition: { x: -2000, y: -4000, z: 8000 } };
  for (const robot of docks) for (const dock of robot) {
    const first = mesh.x.length;
    for (const corner of ball.corners) {
      mesh.x.push(dock[0] + radius * corner[0]);
      mesh.y.push(dock[1] + radius * corner[1]);
      mesh.z.push(dock[2] + radius * corner[2]);
    }
    for (const [a, b, c] of ball.faces) {
      mesh.i.push(first + a); mesh.j.push(first + b); mesh.k.push(first + c);
    }
  }
  return mesh;
}

function lines(pairs, look) {
  const trace = { type: "scatter3d", mode: "lines", x: [], y: [], z: [], hoverinfo: "skip", ...look };
  for (const [from, to] of pairs) {
    trace.x.push(from[0], to[0], null);
    trace.y.push(from[1], to[1], null);
    trace.z.push(from[2], to[2], null);
  }
  return trace;
}

function markers(centers, look, text) {
  return { type: "scatter3d", mode: "markers", text, hoverinfo: "text",
    x: centers.map((p) => p[0]), y: centers.map((p) => p[1]), z: centers.map((p) => p[2]), ...look };
}

function tracesOf(shown, count, ball, offsets, wanted) {
  const bar = { title: { text: "error [R]" }, thickness: 14, len: 0.6 };
  const scale = { colorscale: ERROR_COLORS, cmin: 0, cmax: shown.worst };
  const truth = shown.true.slice(0, count), estimate = shown.estimate.slice(0, count);
  const error = shown.error.slice(0, count);
  const text = error.map((e, n) => `robot ${shown.robot[n]}, join ${n}<br>error ${e} R`);
  const traces = [];
  const robots = (poses, turns, radius, solid, small) => {
    if (shown.robot.length > SOLID) {
      traces.push(markers(poses, { ...small, marker: { size: 3, ...small.marker } }, text));
      return;
    }
    const docks = poses.map((center, n) => docksOf(center, turns[n], offsets));
    const arms = docks.flatMap((own, n) => own.map((dock) => [poses[n], dock]));
    traces.push(spheres(docks, radius, ball, solid));
    traces.push(lines(arms, { line: { color: small.arm, width: 5 } }));
    traces.push(markers(poses, { marker: { size: 5, ...small.marker, showscale: false } }, text));
  };
  if (wanted.truth) {
    robots(truth, shown.turn, 0.72, { color: TRUE_COLOR, hoverinfo: "skip" },
      { arm: TRUE_COLOR, marker: { color: TRUE_COLOR } });
  }
  if (wanted.estimate) {
    const each = ball.corners.length * offsets.length;
    const intensity = error.flatMap((e) => Array(each).fill(e));
    robots(estimate, shown.sensed, 0.6,
      { intensity, ...scale, colorbar: bar, hoverinfo: "skip" },
      { arm: "#b08030", marker: { color: error, ...scale, colorbar: bar, showscale: true } });
  }
  if (wanted.error) {
    const pairs = truth.map((center, n) => [center, estimate[n]]);
    traces.push(lines(pairs, { line: { color: "#222", width: 2.5 } }));
  }
  return traces;
}

function boxOf(shown) {
  const axes = {}, sides = {};
  ["x", "y", "z"].forEach((name, k) => {
    const places = [...shown.true, ...shown.estimate].map((center) => center[k]);
    const reach = 3; // a robot's docks lie within this
    const range = [Math.min(...places) - reach, Math.max(...places) + reach];
    axes[`${name}axis`] = { range, title: { text: `${name} [R]` }, backgroundcolor: "#fff",
      gridcolor: "#dde2e8", showbackground: true, zeroline: false, showspikes: false };
    sides[name] = range[1] - range[0];
  });
  const mean = Math.cbrt(sides.x * sides.y * sides.z);
  const longest = Math.max(sides.x, sides.y, sides.z) / mean;
  const away = 0.75 + 0.85 * longest;
  return { ...axes, aspectmode: "manual",
    aspectratio: { x: sides.x / mean, y: sides.y / mean, z: sides.z / mean },
    camera: { eye: { x: 0.55 * away, y: -0.85 * away, z: 0.2 * away },
      center: { x: 0, y: 0, z: -0.08 * sides.z / mean } } };
}

function showSpace() {
  const data = JSON.parse(document.getElementById("data").textContent);
  const [picker, slider, joined] = ["case", "joins", "joined"].map((id) => document.getElementById(id));
  const boxes = ["truth", "estimate", "error"].map((id) => [id, document.getElementById(`show-${id}`)]);
  data.cases.forEach((shown, place) => picker.add(new Option(shown.name, place)));
  const draw = () => {
    const shown = data.cases[picker.value];
    const wanted = Object.fromEntries(boxes.map(([id, box]) => [id, box.checked]));
    const traces = tracesOf(shown, Number(slider.value), sphere(shown.robot.length <= ROUND),
      data.offsets, wanted);
    joined.textContent = `${slider.value} of ${shown.robot.length}`;
    const layout = { scene: boxOf(shown), showlegend: false, uirevision: picker.value,
      margin: { l: 0, r: 0, t: 0, b: 0 } };
    Plotly.react("view", traces, layout, { responsive: true, displaylogo: false });
  };
  let due = 0;
  const soon = () => { clearTimeout(due); due = setTimeout(draw, 0); };
  const choose = () => {
    slider.max = data.cases[picker.value].robot.length; // before the value, which it bounds
    slider.value = slider.max;
    draw();
  };
  picker.addEventListener("change", choose);
  slider.addEventListener("input", soon);
  boxes.forEach(([, box]) => box.addEventListener("change", soon));
  choose();
}

if (document.getElementById("view")) showSpace();
