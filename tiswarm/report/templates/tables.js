// --- tables: sorting, filtering, and a link to their cells as CSV ---

// The first number of a cell such as `+0.72 ± 0.10`, or its text.
function keyOf({ className, textContent: text }) {
  const number = className === "text" ? null : text.match(/[-+]?\d+(\.\d*)?(e[-+]?\d+)?/i);
  return number ? Number(number[0]) : text;
}

// The rows of a part of a table, without the point of the sweep that heads them.
const rowsOf = ({ rows }) => [...rows].filter(({ className }) => className !== "point");

// The text of a cell in a CSV; numbers with their spread stay as they are.
const writtenOf = ({ className, tagName, textContent: text }) => (className === "text" || tagName === "TH" ? notComputed(text) : text);

function compare(a, b) {
  if (typeof a === "number" && typeof b === "number") return a - b;
  if (typeof a === typeof b) return a.localeCompare(b, "en", { numeric: true });
  return typeof a === "number" ? -1 : 1; // numbers before words and empty cells
}

for (const table of document.querySelectorAll("table")) {
  const bodies = [...table.tBodies], heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.firstChild.addEventListener("click", () => {
    const way = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", way > 0 ? "ascending" : "descending");
    const inOrder = (a, b) => way * compare(keyOf(a.cells[column]), keyOf(b.cells[column]));
    for (const body of bodies) body.append(...rowsOf(body).sort(inOrder));
  }));
  const link = document.createElement("a");
  link.className = "csv";
  link.textContent = "Download CSV";
  link.download = `${table.dataset.name}.csv`;
  link.href = "#";
  link.addEventListener("click", () => {
    const quoted = (text) => `"${text.replaceAll("\u00a0", " ").replaceAll('"', '""')}"`;
    const pointOf = (row) => {
      const heading = row.parentElement.querySelector(".point");
      if (heading) return notComputed(heading.textContent);
      return table.querySelector(".point") ? "point" : null;
    };
    const rows = [table.tHead, ...bodies].flatMap(rowsOf).map((row) => [pointOf(row), ...[...row.cells].map(writtenOf)].filter((text) => text !== null).map(quoted).join(","));
    link.href = `data:text/csv;charset=utf-8,${encodeURIComponent(rows.join("\n") + "\n")}`;
  });
  table.parentElement.after(link);
}

addEventListener("beforeprint", () => document.querySelectorAll("details.more").forEach((more) => { more.open = true; }));

document.getElementById("filter")?.addEventListener("input", ({ target }) => {
  const words = target.value.toLowerCase().split(/\s+/);
  const rows = [...target.closest("section").querySelectorAll("tbody tr")];
  for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
  document.getElementById("matches").textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
});
