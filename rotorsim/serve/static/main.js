// The page: bars, sheet, inspector, results.

import { html, render } from "./vendor/htm-preact-3.1.1.module.js";
import { app, drawnBy, enter, redo, set, start, undo } from "./app.js";
import { find, fit, zoom } from "./camera.js";
import { Dialog } from "./dialogs.js";
import { Gallery } from "./gallery.js";
import { Inspector } from "./inspector.js";
import { onKey } from "./keys.js";
import { get, token } from "./live.js";
import { Problems } from "./problems.js";
import { Found, Recordings } from "./recordings.js";
import { Results, RunBar } from "./runs.js";
import { copy, paste } from "./selection.js";
import { Sheet, follow } from "./sheet.js";

async function savePicture() {
  const answer = await get("/api/picture");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = app.state.file.replace(/\.json$/, ".svg");
  link.click();
  URL.revokeObjectURL(link.href);
}

// Where the page is: the diagram that is served, and the sub-diagrams down to the one that is shown.
function Trail() {
  const parts = (app.state.part ?? "").split("/").filter(Boolean);
  if (!parts.length) return null;
  const up = parts.map((name, k) => [name, parts.slice(0, k + 1).join("/")]);
  return html`<nav class="trail" aria-label="Sub-diagrams"><button data-testid="top" title="To the whole diagram (b: one up)" onClick=${() => enter("")}>${app.state.top}</button>
    ${up.map(([name, part], k) => html`<span>›</span>${k < up.length - 1 ? html`<button onClick=${() => enter(part)}>${name}</button>` : html`<b>${name}</b>`}`)}</nav>`;
}

function Bar() {
  const writes = app.state && !app.state.read_only;
  const undoes = app.undo[app.undo.length - 1]?.title;
  const redoes = app.redo[app.redo.length - 1]?.title;
  return html`<header>
    ${app.state.part ? html`<${Trail} />` : html`<strong class="name">${app.state.view?.name ?? app.state.file}</strong>`}
    <span class="file">${app.state.file}${app.state.read_only ? ", read only" : ""}</span>
    ${writes &&
    html`<button data-testid="undo" disabled=${!undoes} title=${undoes ? `Undo: ${undoes} (Ctrl+Z)` : "Nothing to undo"} onClick=${undo}>Undo</button>
      <button data-testid="redo" disabled=${!redoes} title=${redoes ? `Redo: ${redoes} (Ctrl+Y)` : "Nothing to redo"} onClick=${redo}>Redo</button>
      <button data-testid="add" title="Add a block (a)" onClick=${() => set({ dialog: { kind: "palette" } })}>Add block</button>`}
    <input type="search" data-testid="search" placeholder="Find a block (/)" aria-label="Find a block"
      value=${app.search} onInput=${(event) => find(event.target.value)} />
    <span class="group" role="group" aria-label="Zoom">
      <button aria-label="Smaller" onClick=${() => zoom(1 / 1.25)}>−</button>
      <button title="The whole diagram (f)" onClick=${fit}>Fit</button>
      <button aria-label="Larger" onClick=${() => zoom(1.25)}>+</button>
    </span>
    <button title="Save the picture of the diagram as SVG" data-testid="picture" onClick=${savePicture}>Picture</button>
    <button title="Keys (?)" onClick=${() => set({ dialog: { kind: "keys" } })}>Keys</button>
  </header>`;
}

function Banners() {
  const first = app.state?.problems?.find((one) => one.severity === "error");
  return html`${app.lost
    ? html`<div class="banner" role="alert" data-testid="lost">
        ${app.lost === 4403 ? "This address is not known: open the one that 'rotorsim serve' printed." : "No connection to rotorsim serve; trying again every second."}
      </div>`
    : null}
  ${app.state && app.state.file && !app.state.valid
    ? html`<div class="banner" role="alert" data-testid="banner">
        The file on disk cannot be drawn: ${first ? `${first.place ? first.place + ": " : ""}${first.subject ? first.subject + ": " : ""}${first.what}` : ""}. This is the last good picture; nothing is written over your edit.
      </div>`
    : null}`;
}

// The line between sheet and results: dragged, or moved with the arrows.
function Split() {
  const rows = (share) => {
    app.share = Math.min(Math.max(share, 0.15), 0.85);
    const main = document.querySelector("main");
    main.style.gridTemplateRows = `minmax(0, ${app.share}fr) 7px minmax(0, ${1 - app.share}fr)`;
  };
  const drag = (event) => {
    event.preventDefault();
    const box = document.querySelector("main").getBoundingClientRect();
    follow((next) => rows((next.clientY - box.top) / box.height), () => set({}));
  };
  const press = (event) => {
    const step = { ArrowUp: -0.05, ArrowDown: 0.05 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    rows((app.share ?? 0.55) + step);
    set({});
  };
  return html`<div class="split" role="separator" aria-orientation="horizontal" aria-label="Height of the diagram" tabindex="0"
    aria-valuenow=${Math.round((app.share ?? 0.55) * 100)} aria-valuemin="15" aria-valuemax="85" onPointerDown=${drag} onKeyDown=${press}></div>`;
}

function Page() {
  if (!token()) {
    return html`<main class="alone"><h1>rotorsim</h1><p>Open the address that <code>rotorsim serve</code> printed.</p></main>`;
  }
  if (!app.state) return html`<main class="alone"><${Banners} /><p>Connecting to rotorsim serve ...</p></main>`;
  if (!app.state.file) return html`<${Banners} /><${Gallery} />`;
  return html`<${Bar} /><${Banners} />
    <main>
      <section class="left" aria-label="Diagram"><${Sheet} /><${Problems} /></section>
      <${Split} /><aside aria-label="Inspector"><${Inspector} /></aside>
      <section class="runs" aria-label="Runs"><div class="set"><${RunBar} /><${Recordings} /></div><div class="results"><${Found} /><${Results} /></div></section>
    </main>
    <${Dialog} />
    <div class="said" role="status" aria-live="polite">${app.said}</div>`;
}

drawnBy(() => render(html`<${Page} />`, document.getElementById("page")));
set({});
addEventListener("keydown", onKey);
addEventListener("copy", copy);
addEventListener("paste", paste);
addEventListener("hashchange", () => location.reload()); // the address of a server that was started again
if (token()) start();
