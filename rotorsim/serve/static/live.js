// The connection to the server: the token, requests with their answers, and what the server says by itself.

const KEPT = "rotorsim-token";
export const shown = { part: "" }; // the sub-diagram whose file the page shows

export function token() {
  const given = location.hash.slice(1);
  if (given) {
    sessionStorage.setItem(KEPT, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEPT) ?? "";
}

export async function get(path) {
  const answer = await fetch(shown.part ? `${path}?part=${encodeURIComponent(shown.part)}` : path, { headers: { "X-Rotorsim-Token": token() } });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer;
}

export async function post(path, data) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { "X-Rotorsim-Token": token(), "Content-Type": "application/json" },
    body: JSON.stringify(data),
  });
  return answer.json();
}

// A message with numbers: length of the JSON, JSON, time (64 bit), and rows (32 bit).
function unpacked(bytes) {
  const length = new DataView(bytes).getUint32(0, true);
  const data = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const [n, first] = [data.time, 4 + length];
  data.time = new Float64Array(bytes, first, n);
  data.values = Array.from({ length: data.values }, (_, k) => new Float32Array(bytes, first + 8 * n + 4 * n * k, n));
  return data;
}

export class Live {
  constructor(told, lost) {
    this.told = told;
    this.lost = lost;
    this.count = 0;
    this.waiting = new Map();
    this.back = []; // who waits for the connection
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/api/live`);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ token: token(), part: shown.part }));
    socket.onmessage = (event) => this.receive(typeof event.data === "string" ? JSON.parse(event.data) : unpacked(event.data));
    socket.onclose = (event) => {
      for (const { answer } of this.waiting.values()) answer({ kind: "lost" });
      this.waiting.clear();
      this.lost(event.code);
      if (event.code !== 4403) setTimeout(() => this.connect(), 1000);
    };
  }

  receive(data) {
    if (data.kind === "state") {
      shown.part = data.part ?? "";
      this.told(data);
      for (const go of this.back.splice(0)) go();
    }
    const request = this.waiting.get(data.id);
    if (!request) return;
    if (data.kind === "progress") request.progress?.(data.share, data);
    else {
      this.waiting.delete(data.id);
      request.answer(data);
    }
  }

  // Returns the answer to a message: never fails, a lost connection is an answer of kind "lost".
  ask(message, progress) {
    const id = ++this.count;
    return new Promise((answer) => {
      if (this.socket.readyState !== WebSocket.OPEN) return answer({ kind: "lost" });
      this.waiting.set(id, { answer, progress });
      this.socket.send(JSON.stringify({ ...message, id }));
      message.started?.(id);
    });
  }

  // The same for an edit: where the connection breaks it is asked again, with its key, and made once.
  async askOnce(message) {
    const keyed = { ...message, key: crypto.randomUUID() };
    for (;;) {
      const found = await this.ask(keyed);
      if (found.kind !== "lost") return found;
      await new Promise((go) => this.back.push(go));
    }
  }

  cancel(id) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ kind: "cancel", id }));
  }
}
