// Dialogs: the palette, lists to choose from, renaming, conflicts, keys.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { app, block, cell, edit, free, live, set } from "./app.js";
import { cellAt } from "./camera.js";
import { KEYS } from "./keys.js";
import { get } from "./live.js";
import { follow } from "./sheet.js";

const close = () => set({ dialog: null });

function Box({ title, id, children }) {
  const box = useRef(null);
  useEffect(() => {
    const before = document.activeElement;
    (box.current.querySelector("input, select, .list button:not([disabled])") ?? box.current.querySelector("button")).focus();
    return () => queueMicrotask(() => before?.focus?.()); // not while the page is drawn
  }, []);
  const onKeyDown = (event) => {
    event.stopPropagation();
    if (event.key === "Enter" && event.target.tagName === "INPUT") event.preventDefault(); // else it would press what has the focus next
    if (event.key === "Escape") return close();
    if (!box.current) return; // it was closed by this key
    const all = [...box.current.querySelectorAll("button:not([disabled]), input, select")];
    const at = all.indexOf(document.activeElement);
    if (event.key === "Tab") {
      event.preventDefault();
      all[(at + (event.shiftKey ? -1 : 1) + all.length) % all.length].focus();
    } else if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      all[Math.min(Math.max(at + (event.key === "ArrowDown" ? 1 : -1), 0), all.length - 1)].focus();
    }
  };
  return html`<div class="veil" onPointerDown=${(event) => event.target === event.currentTarget && close()}>
    <div class="dialog" role="dialog" aria-modal="true" aria-label=${title} data-testid=${id} ref=${box} onKeyDown=${onKeyDown}>
      <h2>${title}</h2>${children}<p class="actions"><button onClick=${close}>Close</button></p>
    </div></div>`;
}

let types = null;

function Palette() {
  const [known, show] = useState(types);
  const [text, type] = useState("");
  useEffect(() => {
    if (!known) get("/api/palette").then(async (answer) => show((types = (await answer.json()).types)));
  }, []);
  const wanted = text.toLowerCase().split(/\s+/);
  const fitting = (known ?? []).filter((one) => wanted.every((word) => `${one.type} ${one.category} ${one.summary}`.toLowerCase().includes(word)));
  fitting.sort((a, b) => b.type.startsWith(text) - a.type.startsWith(text) || a.category.localeCompare(b.category));
  const drag = (event, one) => {
    const [x, y] = [event.clientX, event.clientY];
    const ghost = document.createElement("div");
    ghost.className = "ghost";
    ghost.textContent = one.type;
    const moved = (next) => {
      if (!ghost.isConnected && Math.hypot(next.clientX - x, next.clientY - y) < 6) return;
      if (!ghost.isConnected) {
        close();
        document.body.append(ghost);
      }
      Object.assign(ghost.style, { left: `${next.clientX}px`, top: `${next.clientY}px` });
    };
    follow(moved, (next) => {
      const at = ghost.isConnected && next && cellAt(next);
      ghost.remove();
      if (at) edit([{ op: "add", type: one.type, at: free("", ...at), parameters: {} }]);
    });
  };
  const add = (one) => {
    const chosen = block(app.selected?.block);
    const rows = app.state.view.rows.map((each) => each.value);
    const at = chosen ? free("", ...cell(chosen)) : [0, (rows[rows.length - 1] ?? -1) + 1];
    close();
    edit([{ op: "add", type: one.type, at, parameters: {} }]);
  };
  return html`<${Box} title="Add a block" id="palette">
    <input type="search" role="searchbox" aria-label="Find a type" placeholder="type, category or words" value=${text} onInput=${(event) => type(event.target.value)}
      onKeyDown=${(event) => event.key === "Enter" && fitting[0] && add(fitting[0])} />
    <div class="list">${fitting.map(
      (one) => html`<button key=${one.type} data-testid=${`palette-${one.type}`} onClick=${() => add(one)} onPointerDown=${(event) => event.button === 0 && drag(event, one)}>
        <b>${one.type}</b> <span class="kind">${one.category}</span><br />${one.summary}</button>`,
    )}</div><//>`;
}

function Swap({ name }) {
  const [found, show] = useState(null);
  useEffect(() => {
    live.ask({ kind: "types", block: name }).then(show);
  }, []);
  const take = (type) => {
    close();
    edit([{ op: "swap", block: name, type }]);
  };
  if (!found) return null; // so that the first type has the focus at once
  return html`<${Box} title=${`Swap ${name}, values of equal name are kept`}>
    <div class="list">${(found.types ?? []).map((type) => html`<button key=${type} onClick=${() => take(type)}>${type}</button>`)}
      ${!found.types?.length ? html`<p>No other type has these ports.</p>` : null}</div><//>`;
}

function Rename({ name }) {
  const [to, type] = useState(name);
  const done = async () => {
    close();
    if (to !== name) await edit([{ op: "rename", block: name, to }]);
  };
  return html`<${Box} title=${`Rename ${name}`}>
    <input aria-label="New name" value=${to} onInput=${(event) => type(event.target.value)} onKeyDown=${(event) => event.key === "Enter" && done()} />
    <button onClick=${done}>Rename</button><//>`;
}

function Group({ blocks }) {
  const [name, type] = useState("part");
  const done = () => {
    close();
    edit([{ op: "group", blocks, name }]);
  };
  return html`<${Box} title=${`Group ${blocks.length === 1 ? blocks[0] : `${blocks.length} blocks`} into a sub-diagram`}>
    <p class="hint">It gets a file of its own beside this one, and a port for each signal that goes in or out. Signals inside are called ${name}/block.port from then on: recordings of them have to say so.</p>
    <input aria-label="Name of the sub-diagram" data-testid="group-name" value=${name} onInput=${(event) => type(event.target.value)} onKeyDown=${(event) => event.key === "Enter" && done()} />
    <button onClick=${done}>Group</button><//>`;
}

// Wires a block without a mouse: first one of its ports, then the other end.
function WireUp({ name }) {
  const one = block(name);
  const [port, choose] = useState(null);
  const [fits, show] = useState([]);
  const pick = async (side, at) => {
    const found = await live.ask({ kind: "fits", port: `${name}.${at.name}` });
    show([...(found.ports ?? [])].sort((a, b) => b.ok - a.ok));
    choose({ side, name: `${name}.${at.name}` });
  };
  const wire = (other) => {
    close();
    edit([port.side === "out" ? { op: "wire", source: port.name, target: other } : { op: "wire", source: other, target: port.name }]);
  };
  if (!port) {
    const ports = [...one.inputs.map((each) => ["in", each]), ...one.outputs.map((each) => ["out", each])];
    return html`<${Box} title=${`Wire ${name}: which port?`}><div class="list">${ports.map(
      ([side, each]) => html`<button key=${side + each.name} onClick=${() => pick(side, each)}>
        <b>${each.name}</b> ${side === "in" ? "input" : "output"}, ${each.unit} ${each.wired ? "" : ", not wired"}</button>`,
    )}</div><//>`;
  }
  return html`<${Box} key="other" title=${`${port.name} ${port.side === "out" ? "to" : "from"} ...`}><div class="list">${fits.map(
    (each) => html`<button key=${each.port} disabled=${!each.ok} onClick=${() => wire(each.port)}><b>${each.port}</b> ${each.why}</button>`,
  )}</div><//>`;
}

function Conflict({ dialog }) {
  const mine = async () => {
    close();
    const done = await edit(dialog.operations, { base: dialog.found.sha, mine: true, title: dialog.title, where: dialog.where });
    const steps = { undo: app.undo, redo: app.redo }[dialog.where];
    if (!done && app.dialog?.kind !== "conflict") steps?.push({ back: dialog.operations, title: dialog.title }); // it may be tried again
  };
  const value = (one) => (one === null ? "nothing" : one);
  return html`<${Box} title="Changed on both sides" id="conflict">
    <p>The file was changed meanwhile, and nothing of yours is written yet.</p>
    <table><thead><tr><th>entry</th><th>yours</th><th>in the file</th></tr></thead><tbody>${dialog.found.conflicts.map(
      (one) => html`<tr><td>${one.what}</td><td><code>${value(one.mine)}</code></td><td><code>${value(one.theirs)}</code></td></tr>`,
    )}</tbody></table>
    <p class="actions"><button data-testid="conflict-theirs" onClick=${close}>Keep theirs</button>
      <button data-testid="conflict-mine" onClick=${mine}>Write mine</button></p><//>`;
}

function Keys() {
  return html`<${Box} title="Keys"><table><tbody>${KEYS.map(([key, what]) => html`<tr><td><kbd>${key}</kbd></td><td>${what}</td></tr>`)}</tbody></table><//>`;
}

export function Dialog() {
  const dialog = app.dialog;
  if (!dialog) return null;
  const made = {
    palette: () => html`<${Palette} />`,
    swap: () => html`<${Swap} name=${dialog.block} />`,
    rename: () => html`<${Rename} name=${dialog.block} />`,
    group: () => html`<${Group} blocks=${dialog.blocks} />`,
    wire: () => html`<${WireUp} name=${dialog.block} />`,
    conflict: () => html`<${Conflict} dialog=${dialog} />`,
    keys: () => html`<${Keys} />`,
  };
  return made[dialog.kind]();
}
