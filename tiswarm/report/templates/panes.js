// --- panes of the 3D view: cases side by side under one camera, and their motion ---

const GROWTH_MS = 6000, STEPS = 12; // duration of a motion; its steps where the reader wants less motion
const WHOLE = 200; // places of the slider along iterations
const WIDE = 960; // width of a window from which two cases are shown [pixels]
const STILL = 4; // way of the pointer up to which it clicks [pixels]
const CALM = matchMedia("(prefers-reduced-motion: reduce)");

// Root mean square error of estimated centers; NaN without a truth.
function rmseOf(truth, estimate) {
  const squares = truth.map((point, n) => { const off = minus(point, estimate[n]); return dot(off, off); });
  return squares.length ? Math.sqrt(squares.reduce((sum, each) => sum + each, 0) / squares.length) : NaN;
}

// A case at a share of its iterations: centers between two stored ones, and the iteration. A case without a trace stands still.
function atShare(shown, share) {
  if (!shown.trace) return { ...shown, iteration: null };
  const { iteration, center } = shown.trace, at = share * (center.length - 1);
  const k = Math.min(Math.floor(at), center.length - 2);
  const estimate = center[k].map((point, n) => mixed(point, center[k + 1][n], at - k));
  return { ...shown, estimate, iteration: Math.round(mixed([iteration[k]], [iteration[k + 1]], at - k)[0]) };
}

// A canvas that shows a case.
function paneOf(view, data) {
  const pen = view.getContext("2d");
  let many; // what draws many robots and spheres; null where the browser has no WebGL
  const pane = { view, case: null, spheres: null, colorings: [], place: null };
  pane.choose = (chosen) => {
    pane.case = chosen;
    pane.spheres = spheresOf(chosen, data);
    pane.colorings = coloringsOf(chosen);
  };
  // The coloring of a label; robots of a case without it are gray. Errors are those of the centers shown.
  pane.coloring = (label, at) => {
    const found = pane.colorings.find((each) => each.label === label);
    if (!found) return { ...pane.colorings[0], least: Infinity, most: -Infinity, value: at.robot.map(() => null) };
    if (label !== "error" || at === pane.case || !at.true.length) return found;
    return { ...found, value: at.true.map((point, n) => data.radius * Math.hypot(...minus(point, at.estimate[n]))) };
  };
  // Draws the first robots of the case as it is at some iteration; returns whether WebGL did.
  pane.draw = (at, { box, look, wanted, coloring, legend, balls, count, title, scaled, followed }) => {
    const [width, height, dense] = [view.clientWidth, view.clientHeight, devicePixelRatio];
    view.width = width * dense;
    view.height = height * dense;
    pen.scale(dense, dense);
    pen.lineCap = "round";
    const { fit, right, down } = fitOf(box, width, height);
    const moved = { ...look, right: look.right + look.zoom * right, down: look.down + look.zoom * down };
    const center = at.estimate[at.robot.indexOf(followed)]; // of the robot that the reader follows
    if (center) {
      const [x, y] = cameraOf(box, moved, fit, width, height).place(center);
      moved.right += look.right + width / 2 - x;
      moved.down += look.down + height / 2 - y;
    }
    const camera = cameraOf(box, moved, fit, width, height);
    pane.place = camera.place;
    drawBox(pen, box, data, camera);
    const wants = { ...wanted, spheres: wanted.spheres && !!pane.spheres };
    if ((wants.spheres || at.robot.length > SOLID) && many === undefined) many = manyRobots();
    const drawn = (wants.spheres || at.robot.length > SOLID) && many
      && (many.load(at, data.offsets, box.middle, pane.spheres), many.draw(pen, count, wants, coloring, { ...camera, width, height, dense }));
    if (!drawn) {
      const pieces = wants.ground ? groundOf(at.ground, camera) : [];
      drawInOrder(pen, pieces, shapesOf(at, Math.min(count, PAINTED), data.offsets, wants, coloring, camera.place, balls));
    }
    if (center) {
      const [x, y, scale] = camera.place(center);
      pen.strokeStyle = textOf("--ink");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x, y, Math.max(NEARBY, 2.6 * scale), 0, 7);
      pen.stroke();
    }
    if (wants.estimate && scaled) drawScale(pen, legend, width, height);
    pen.textAlign = "left";
    pen.textBaseline = "top";
    pen.font = "600 14px system-ui, sans-serif";
    pen.fillStyle = textOf("--ink");
    linesOf(pen, title, width - 20).forEach((line, k) => pen.fillText(line, 10, 10 + 18 * k));
    return drawn;
  };
  return pane;
}

// Breaks a text between words into lines of a width [pixels].
function linesOf(pen, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (pen.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines.filter(Boolean);
}

// What a pane shows, in words.
function titleOf(at, { name }, { radius, unit, score }) {
  const rmse = radius * rmseOf(at.true, at.estimate);
  const error = Number.isNaN(rmse) ? "" : `${score} ${short(rmse)} ${unit}`;
  const iteration = at.iteration === undefined || at.iteration === null ? "" : `iteration ${at.iteration}`;
  return [name, iteration, error].filter(Boolean).join(", ");
}

// Shows cases, `opens` first with that coloring; returns what takes others, and where the reader looks from.
function showSpace(view, data, opens = "") {
  const byId = (id) => document.getElementById(id);
  const [point, picker, beside, quantity, track, slider, joined, play, pointed] = ["point", "case", "beside", "quantity", "track", "joins", "joined", "play", "pointed"].map(byId);
  const boxes = ["truth", "estimate", "error", "spheres", "contacts", "ground"].map((id) => [id, byId(`show-${id}`)]).filter(([, check]) => check);
  const balls = { unknown: ball(UNKNOWN_COLOR) };
  if (data.cases.every(({ ground }) => !ground.length)) byId("show-ground").parentElement.hidden = true;
  for (const scale of ["--errors", "--forces", "--joins", "--labels", "--margins"]) balls[scale] = shadesOf(colorsOf(scale));
  const every = [view, byId("view-beside")].map((canvas) => paneOf(canvas, data));
  let look = { ...START }, panes = [], box, due = 0, began = null, followed = null;
  const points = [...new Set(data.cases.map((each) => each.point ?? ""))];
  points.forEach((each) => point.add(new Option(each)));
  point.parentElement.hidden = points.length < 2;
  // Lists the cases of a point, and keeps the conditions that are shown.
  const list = () => {
    const before = [picker, beside].map((menu) => menu.selectedOptions[0]?.text);
    picker.replaceChildren();
    beside.replaceChildren(new Option("no other", ""));
    beside.parentElement.hidden = data.cases.length < 2;
    data.cases.forEach((each, n) => {
      if ((each.point ?? "") !== points[point.selectedIndex]) return;
      for (const menu of [picker, beside]) menu.add(new Option(each.condition ?? each.name, n));
    });
    [picker, beside].forEach((menu, k) => { menu.selectedIndex = Math.max(0, [...menu.options].findIndex(({ text }) => text === before[k])); });
  };
  list();
  if (data.compared && picker.length > 1 && innerWidth > WIDE) beside.selectedIndex = 2;

  const isTracked = () => track.value === "iterations";
  const draw = () => {
    due = 0;
    if (!view.clientWidth) return;
    balls.truth = ball(colorsOf("--true")[0]); // dark pages have another
    const wanted = Object.fromEntries(boxes.map(([id, check]) => [id, check.checked]));
    const shown = panes.map((pane) => (isTracked() ? atShare(pane.case, slider.valueAsNumber / WHOLE) : pane.case));
    const colorings = panes.map((pane, k) => pane.coloring(quantity.value, shown[k]));
    const most = Math.max(...colorings.map((each) => each.most)), least = Math.min(...colorings.map((each) => each.least)); // one scale for all
    const legend = colorings.find((each) => each.label === quantity.value);
    document.documentElement.style.setProperty("--shown", textOf(legend.scale));
    const drawn = panes.map((pane, k) => pane.draw(shown[k], {
      box, look, wanted, balls, followed, coloring: { ...colorings[k], least, most }, legend: { ...legend, least, most }, scaled: k === panes.length - 1,
      count: isTracked() ? pane.case.robot.length : Math.min(slider.valueAsNumber, pane.case.robot.length),
      title: data.cases.length > 1 || isTracked() ? titleOf(shown[k], pane.case, data) : "",
    }));
    byId("no-spheres").hidden = !wanted.spheres || drawn.every(Boolean);
    if (!isTracked() && !drawn[0]) slider.max = Math.min(PAINTED, slider.max);
    joined.textContent = isTracked() ? `${Math.round(100 * slider.value / WHOLE)} %` : `${slider.value} of ${panes[0].case.robot.length}`;
  };
  const soon = () => { due ||= requestAnimationFrame(draw); };
  const stop = () => { began = null; play.textContent = "Play"; };
  // The slider along robots or iterations, at its end.
  const lay = () => {
    stop();
    slider.min = isTracked() ? 0 : 1;
    slider.max = isTracked() ? WHOLE : Math.max(...panes.map((pane) => pane.case.robot.length)); // before the value, which it bounds
    slider.value = slider.max;
    draw();
  };
  const choose = () => {
    const value = quantity.value || opens;
    panes = every.slice(0, beside.value === "" ? 1 : 2);
    panes.forEach((pane, k) => pane.choose(data.cases[[picker, beside][k].value]));
    every[1].view.hidden = panes.length < 2;
    const { colorings } = panes[0];
    byId("show-spheres").parentElement.hidden = panes.every(({ spheres }) => !spheres);
    quantity.replaceChildren(...colorings.map((each) => new Option(each.label)));
    quantity.selectedIndex = Math.max(0, colorings.findIndex((each) => each.label === value));
    const isTraced = panes.some((pane) => pane.case.trace);
    track.hidden = !isTraced;
    if (!isTraced) track.value = "joins";
    box = boxOf(panes.map((pane) => pane.case), data.radius);
    lay();
  };
  // Moves the slider to its end, from its start if it is there; in a few steps where the reader wants less motion.
  const toggle = () => {
    if (began !== null) { stop(); return; }
    const [low, high] = [Number(slider.min), Number(slider.max)], length = high - low || 1;
    const from = slider.valueAsNumber >= high ? 0 : (slider.valueAsNumber - low) / length;
    play.textContent = "Pause";
    began = performance.now() - from * GROWTH_MS;
    const move = () => {
      if (began === null) return;
      const share = Math.min(1, (performance.now() - began) / GROWTH_MS);
      slider.value = low + length * (CALM.matches ? Math.floor(share * STEPS) / STEPS : share);
      draw();
      if (share < 1) requestAnimationFrame(move);
      else stop();
    };
    move();
  };
  // The place in the list of the robot whose true or estimated center is nearest to the pointer; -1 if none is near.
  const findRobot = (pane, { offsetX, offsetY }) => {
    const { case: shown, place } = pane;
    let found = -1, nearest = NEARBY;
    const count = isTracked() ? shown.robot.length : Math.min(slider.value, shown.robot.length);
    for (let n = 0; n < count; n++) for (const poses of shown.true.length ? [shown.true, shown.estimate] : [shown.estimate]) {
      const [x, y] = place(poses[n]), distance = Math.hypot(x - offsetX, y - offsetY);
      if (distance < nearest) [found, nearest] = [n, distance];
    }
    return found;
  };
  const nameRobot = ({ case: shown, colorings }, found) => {
    const values = colorings.slice(0, -2).map(({ label, unit, value, words, gray }) => `${label} ${value[found] === null ? gray : words[value[found]] ?? `${value[found]} ${unit}`}`.trimEnd());
    pointed.textContent = found < 0 ? "" : `Robot ${shown.robot[found]}, join index ${found}: ${values.join(", ")}.`;
  };
  // Keeps a robot in the middle from now on, or no longer.
  const follow = (pane, found) => {
    followed = found < 0 ? null : pane.case.robot[found];
    look = { ...look, right: 0, down: 0 };
    nameRobot(pane, found);
    soon();
  };
  const change = (act) => { act(); look.tilt = Math.max(-1.57, Math.min(1.57, look.tilt)); soon(); };
  const turn = (right, down) => change(() => { look.turn -= 0.008 * right; look.tilt += 0.008 * down; });
  const move = (right, down) => change(() => { look.right += right; look.down += down; });
  const zoom = (factor) => change(() => ["zoom", "right", "down"].forEach((name) => { look[name] *= factor; }));
  const reset = () => change(() => { look = { ...START }; followed = null; });
  for (const pane of every) listen(pane.view, { turn, move, zoom, reset, toggle, point: (event) => followed === null && nameRobot(pane, findRobot(pane, event)), click: (event) => follow(pane, findRobot(pane, event)) });
  byId("reset").addEventListener("click", reset);
  play.addEventListener("click", toggle);
  for (const menu of [picker, beside]) menu.addEventListener("change", choose);
  point.addEventListener("change", () => { list(); choose(); });
  track.addEventListener("change", lay);
  slider.addEventListener("input", () => { stop(); soon(); });
  quantity.addEventListener("change", soon);
  boxes.forEach(([, check]) => check.addEventListener("change", soon));
  choose();
  new ResizeObserver(soon).observe(view);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  const onPaper = (paper) => { document.documentElement.classList.toggle("paper", paper); draw(); };
  addEventListener("beforeprint", () => onPaper(true));
  addEventListener("afterprint", () => onPaper(false));
  return {
    get look() { return look; },
    set look(chosen) { change(() => { look = chosen; }); },
    get isMoving() { return began !== null; },
    // Takes cases anew; what the reader chose stays, and so does the slider unless it is at its end.
    take(cases) {
      const robots = slider.value < Number(slider.max) && slider.value;
      data.cases = cases;
      list();
      choose();
      if (robots) { slider.value = robots; draw(); }
    },
  };
}

// Mouse, touch and keys on the canvas.
function listen(view, { turn, move, zoom, reset, toggle, point, click }) {
  const touching = new Map(); // pointers by id
  let start = null; // of a click, where the pointer has hardly moved since
  const spanOf = ([a, b]) => Math.hypot(a.x - b.x, a.y - b.y);
  view.addEventListener("pointerdown", (event) => {
    start = touching.size ? null : event;
    touching.set(event.pointerId, { x: event.clientX, y: event.clientY });
    view.setPointerCapture(event.pointerId);
  });
  view.addEventListener("pointerup", (event) => {
    if (start && Math.hypot(event.clientX - start.clientX, event.clientY - start.clientY) < STILL) click(event);
  });
  for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, (event) => touching.delete(event.pointerId));
  view.addEventListener("pointermove", (event) => {
    const before = touching.get(event.pointerId);
    if (!before) { point(event); return; }
    const [right, down] = [event.clientX - before.x, event.clientY - before.y];
    const span = touching.size === 2 ? spanOf([...touching.values()]) : 0;
    touching.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (span) {
      zoom(spanOf([...touching.values()]) / span);
      move(right / 2, down / 2);
    } else if (event.shiftKey || event.buttons > 1) move(right, down);
    else turn(right, down);
  });
  view.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== view) return; // scrolls the page
    event.preventDefault();
    zoom(Math.exp(-0.002 * event.deltaY));
  }, { passive: false });
  view.addEventListener("dblclick", reset);
  view.addEventListener("contextmenu", (event) => event.preventDefault());
  view.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (step) (event.shiftKey ? move : turn)(20 * step[0], 20 * step[1]);
    else if ("+=".includes(event.key)) zoom(1.2);
    else if ("-_".includes(event.key)) zoom(1 / 1.2);
    else if (event.key === " ") toggle();
    else if (event.key === "0" || event.key === "Home") reset();
    else return;
    event.preventDefault();
  });
}
