// What the page knows and does: the state of the file, the selection, edits with undo and redo, dialogs.

import { Live } from "./live.js";

export const app = {
  state: null, // of the file, as the server says
  sha: "", // of the file, as the server said last
  lost: 0, // code of a lost connection
  selected: null, // {block, others: [names]} or {wire: [source, target]}
  dialog: null, // {kind, ...}: palette, choose, rename, conflict, keys
  undo: [], // of the file that is shown
  redo: [],
  said: "",
  refused: [], // problems of the last edit that was refused
  search: "",
};

let draw = () => {};
export function drawnBy(function_) {
  draw = function_;
}
export function set(values) {
  Object.assign(app, values);
  draw();
}

let awaited = null; // tells the blocks that were added or renamed: the state comes behind the answer
let shown = () => {};
export function shownBy(function_) {
  shown = function_;
}

const steps = new Map(); // sub-diagram -> its undo and redo: each file has its own

// Goes into the file of a sub-diagram, "" for the diagram that is served.
export const enter = (part) => after(() => goInto(part)); // behind the edits of the file that is left

async function goInto(part) {
  const found = await live.ask({ kind: "enter", part });
  if (found.kind === "refused") set({ said: `not entered: ${found.problems[0].what}` });
}

// What is kept of the selection: blocks that are still there.
function left(selected, view) {
  const there = (name) => view?.blocks.some((one) => one.name === name);
  if (!selected?.block) return selected;
  const [first, ...others] = [selected.block, ...(selected.others ?? [])].filter(there);
  return first ? { block: first, others } : null;
}

export let live = null;
export function start() {
  live = new Live(
    (state) => {
      const other = app.state && app.state.part !== state.part;
      if (other) {
        steps.set(app.state.part, { undo: app.undo, redo: app.redo });
        Object.assign(app, steps.get(state.part) ?? { undo: [], redo: [] }, { selected: null, refused: [], dialog: null, search: "" });
        awaited = null;
      }
      set({ state, sha: state.sha, lost: 0, selected: left(app.selected, state.view) });
      const [fresh, ...others] = awaited ? (state.view?.blocks ?? []).filter(awaited).map((one) => one.name) : [];
      if (fresh) {
        awaited = null;
        select({ block: fresh, others });
        shown(fresh);
      }
    },
    (code) => set({ lost: code }),
  );
}

export const chosen = () => (app.selected?.block ? [app.selected.block, ...(app.selected.others ?? [])] : []);
export const block = (name) => app.state?.view?.blocks.find((one) => one.name === name);
export const readOnly = () => app.state?.read_only || !app.state?.valid;

export const name_of = (operations) => {
  const first = operations[0];
  const words = {
    move: () => `move ${first.block}`,
    wire: () => `wire ${first.source} to ${first.target}`,
    cut: () => `cut ${first.source} to ${first.target}`,
    set: () => `set ${first.name}`,
    swap: () => `swap ${first.block}`,
    add: () => `add ${first.type}`,
    remove: () => `remove ${first.block}`,
    rename: () => `rename ${first.block}`,
    record: () => `record ${first.signal}`,
    group: () => `group ${first.blocks.join(", ")}`,
    dissolve: () => `dissolve ${first.block}`,
    insert: () => `add ${Object.keys(first.blocks).join(", ")}`,
    port: () => `change port ${first.end}`,
  };
  if (operations.length > 1 && operations.every((one) => one.op === first.op)) return `${first.op} ${operations.length} blocks`;
  return words[first.op]?.() ?? "edit";
};

const DONE = { move: "moved", wire: "wired", swap: "swapped", add: "added", remove: "removed", rename: "renamed", group: "grouped", dissolve: "dissolved", change: "changed", record: "changed what is recorded:" };

// What is said of an edit that is done: "wired rotor.displacement to amb.displacement".
const saidOf = (title) => title.replace(/^\w+/, (word) => DONE[word] ?? word);

let last = Promise.resolve(); // edits go one after the other

const after = (work) => (last = last.then(work));

// Sends an edit; where: which list takes what undoes it. Returns whether it was written.
export const edit = (operations, more) => {
  const part = app.state.part; // the file that it is made on
  return after(() => send(operations, { part, ...more }));
};

async function send(operations, { part, base, mine = false, title, where = "new" }) {
  if (readOnly() || !operations.length) return false;
  awaited = null;
  const known = base ?? app.sha;
  const before = new Set(app.state.view.blocks.map((one) => one.name));
  const found = await live.askOnce({ kind: "edit", part, base: known, operations, mine });
  const words = title ?? name_of(operations);
  if (found.kind === "done") {
    const step = { back: found.undo, title: words };
    app.sha = found.sha;
    if (where === "undo") {
      app.redo.push(step);
    } else {
      app.undo.push(step);
      if (where === "new") app.redo.length = 0;
    }
    const kept = words.startsWith("group ") ? "; the file of the sub-diagram stays, with what was changed in it" : "";
    const said = { undo: `taken back: ${words}${kept}`, redo: `done again: ${words}` }[where] ?? saidOf(words);
    if (["add", "insert", "group"].includes(operations[0].op)) awaited = (one) => !before.has(one.name);
    if (operations[0].op === "rename") awaited = (one) => one.name === operations[0].to;
    set({ said, refused: [] });
    return true;
  }
  if (found.kind === "conflict") {
    set({ dialog: { kind: "conflict", found, operations, title: words, where } });
  } else {
    set({ refused: found.problems, said: `not done: ${found.problems[0].what}` });
  }
  return false;
}

export const undo = () => stepBack("undo");
export const redo = () => stepBack("redo");

function stepBack(where) {
  const part = app.state.part;
  return after(() => (app.state.part === part ? back(app[where], where) : null));
}

async function back(steps, where) {
  const step = steps.pop();
  if (step && !(await send(step.back, { part: app.state.part, title: step.title, where })) && app.dialog?.kind !== "conflict") steps.push(step);
  set({});
}

export function select(selected) {
  set({ selected, refused: [] });
}

// The values of column and row at which a block stands.
export function cell(one) {
  const view = app.state.view;
  const within = (cells, start, end, at) => cells.find((each) => at >= each[start] - 1 && at <= each[end] + 1);
  const column = within(view.columns, "left", "right", one.x + one.width / 2);
  const row = within(view.rows, "top", "bottom", one.y + one.height / 2);
  return [column?.value ?? 0, row?.value ?? 0];
}

// The value for a place [px]: that of the column or row there, or one between two of them.
export function valueAt(cells, start, end, at) {
  if (!cells.length) return 0;
  if (at < cells[0][start]) return cells[0].value - 1;
  for (let k = 0; k < cells.length; k++) {
    if (at <= cells[k][end]) {
      return at >= cells[k][start] ? cells[k].value : (cells[k - 1].value + cells[k].value) / 2;
    }
  }
  return cells[cells.length - 1].value + 1;
}

// The cell that a block may have; where another stands there, in a row of its own below that.
export function free(name, column, row) {
  const taken = app.state.view.blocks.some((one) => {
    const [c, r] = cell(one);
    return one.name !== name && c === column && r === row;
  });
  const rows = app.state.view.rows.map((one) => one.value);
  const next = rows.find((value) => value > row);
  return [column, taken ? (next === undefined ? row + 1 : (row + next) / 2) : row];
}

export const move = (name, column, row) => edit([{ op: "move", block: name, to: free(name, column, row) }]);

// Moves blocks together, by columns and rows.
export const moveBy = (names, columns, rows) =>
  edit(names.map((name) => {
    const [column, row] = cell(block(name));
    return { op: "move", block: name, to: [column + columns, row + rows] };
  }));
