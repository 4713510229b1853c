// --- structures while they grow ---

const WAIT_MS = 1000, SILENT_MS = 10000; // between two looks at the state; after which silence is stated
const canvas = document.getElementById("view"), result = document.getElementById("result");
const data = JSON.parse(document.getElementById("data").textContent);
const { folder, news } = JSON.parse(document.getElementById("growth").textContent);
const LOOK = `tiswarm look ${location.pathname}`;
let structures = [], space = null, next = null, heard = "", heardAt = Date.now();

// Adds what is new to the structures, or begins with others.
function take({ names, structure, offsets, center, turn, contacts, gone, broken, load, ground }) {
  if (names) {
    structures = names.map((name) => ({ name, center: [], turn: [], contacts: [], gone: new Set(), broken: new Set(), load: [], ground: [] }));
    return;
  }
  const grown = structures[structure];
  data.offsets = offsets ?? data.offsets;
  for (const [to, values] of [[grown.center, center], [grown.turn, turn], [grown.contacts, contacts]]) for (const value of values ?? []) to.push(value);
  for (const robot of gone ?? []) grown.gone.add(robot);
  for (const ends of broken ?? []) grown.broken.add(String(ends));
  grown.load = load ?? grown.load;
  grown.ground = ground ?? grown.ground;
}

// A structure as the 3D view has cases, without robots that are gone and contacts that broke.
function caseOf({ name, center, turn, contacts, gone, broken, load, ground }) {
  const robot = center.map((_, n) => n).filter((n) => !gone.has(n));
  const place = new Map(robot.map((number, n) => [number, n])), docks = data.offsets.length;
  const isWhole = ([i, a, j, b]) => place.has(i) && place.has(j) && !broken.has(`${docks * i + a},${docks * j + b}`);
  const chosen = (values) => robot.map((n) => values[n] ?? null);
  const estimate = chosen(center), sensed = chosen(turn), value = chosen(load);
  return {
    name, robot, true: [], turn: [], estimate, sensed, trace: null, ground,
    contacts: contacts.filter(isWhole).map(([i, a, j, b]) => [place.get(i), a, place.get(j), b]),
    colors: value.some((load) => load !== null) ? [{ ...data.coloring, value }] : [],
  };
}

// Shows all robots that have joined; a motion that the reader plays goes on to its end first.
function show() {
  const cases = structures.map(caseOf).filter(({ robot }) => robot.length);
  if (!cases.length || space?.isMoving) return;
  if (space) space.take(cases);
  else {
    data.cases = cases;
    space = showSpace(canvas, data, "join index");
    try { space.look = JSON.parse(sessionStorage.getItem(LOOK)) ?? space.look; } catch { /* a frame without storage */ }
  }
}

// A notebook replaces the page: the next one looks from where the reader did.
for (const kind of ["pointerup", "wheel", "keyup", "dblclick", "click"]) addEventListener(kind, () => {
  try { if (space) sessionStorage.setItem(LOOK, JSON.stringify(space.look)); } catch { /* a frame without storage */ }
});

// Loads a script beside the page, and returns what it calls `tiswarm` with. Pages of files can fetch nothing.
let received;
globalThis.tiswarm = (value) => { received = value; };
const loaded = (file) => new Promise((resolve, reject) => {
  const script = document.createElement("script");
  script.src = `${folder}/${file}`;
  script.onload = () => { script.remove(); resolve(received); };
  script.onerror = () => { script.remove(); reject(new Error(`${script.src} is missing`)); };
  document.head.append(script);
});

async function look() {
  let state = null;
  try {
    state = await loaded(`state.js?${Date.now()}`);
    if (next === null || state.first > next) next = state.first;
    const isNew = next < state.next;
    while (next < state.next) {
      (await loaded(`${next}.js?${state.first}`)).forEach(take);
      next += 1;
    }
    if (isNew) show();
  } catch {
    state = null; // it is being written, or the folder is gone
  }
  if (state && state.line !== heard) [heard, heardAt] = [state.line, Date.now()];
  const silent = Date.now() - heardAt;
  result.textContent = state?.ended || silent < SILENT_MS ? heard : `${heard} No news for ${Math.round(silent / 1000)} s.`;
  if (state?.results) {
    const link = document.createElement("a");
    [link.href, link.textContent] = [state.results, "All results"];
    result.append(" ", link);
  }
  if (state?.ended && !space?.isMoving) show();
  if (!state?.ended) setTimeout(look, WAIT_MS);
}

if (news) {
  news.forEach(take);
  show();
} else look();
