// Frames: what optsc/live/frames.py packs, from the socket or out of the page itself.

const decoder = new TextDecoder();

export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(decoder.decode(new Uint8Array(buffer, 4, length)));
  return { header, numbers: new Float32Array(buffer, 4 + length) };
}

// A moment of a scene: numbers by the names of the scene's columns.
export class Moment {
  constructor(scene, { header, numbers }) {
    this.scene = scene;
    this.time = header.t;
    this.reason = header.reason;
    this.silent = header.silent || 0;
    this.numbers = numbers;
  }

  of(name) {
    const [start, stop] = this.scene.columns[name];
    return this.numbers.subarray(start, stop);
  }

  one(name) {
    return this.numbers[this.scene.columns[name][0]];
  }

  get mode() {
    return this.scene.modes[this.one("mode")] || "hold";
  }

  get status() {
    return this.scene.statuses[this.one("status")] || "";
  }

  get automatic() {
    return this.mode !== "hold" && this.mode !== "manual";
  }

  // The settings in force, by name.
  get settings() {
    const values = this.of("settings");
    const all = Object.fromEntries(Object.keys(this.scene.settings).map((name, k) => [name, values[k]]));
    return { ...all, rule: this.scene.rules[all.rule] };
  }

  name(column) {
    const index = this.one(column);
    return index >= 0 ? this.scene.objects[index].name : null;
  }
}

// The live stream: connects, connects again when it is lost, and calls the handlers it is given.
export class Socket {
  constructor(handlers) {
    this.handlers = handlers;
    this.scene = null;
    this.ready = false;
    this.connect();
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/socket${location.search}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (event) => this.take(event.data);
    this.socket.onclose = () => {
      this.ready = false;
      this.handlers.lost();
      setTimeout(() => this.connect(), 1000);
    };
  }

  take(data) {
    if (typeof data === "string") {
      this.handlers.said(JSON.parse(data));
      return;
    }
    const frame = unpack(data);
    if (frame.header.kind === "scene") {
      this.scene = frame.header;
      this.ready = true;
      this.handlers.scene(frame.header, frame.numbers);
    } else if (this.scene) {
      this.handlers.moment(new Moment(this.scene, frame));
    }
  }

  // Nothing is queued while the network is slow: what cannot be sent now is of the past when it can.
  send(message) {
    if (!this.ready || this.socket.readyState !== WebSocket.OPEN || this.socket.bufferedAmount > 4096) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}

// A recorded stream inside the page: frames, each behind its length.
export function embedded() {
  const element = document.getElementById("stream");
  if (!element) return null;
  const bytes = Uint8Array.from(atob(element.textContent.trim()), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const frames = [];
  for (let at = 0; at < bytes.length; ) {
    const length = view.getUint32(at, true);
    frames.push(unpack(bytes.buffer.slice(at + 4, at + 4 + length)));
    at += 4 + length;
  }
  const [first, ...others] = frames;
  return { scene: first.header, numbers: first.numbers, moments: others.map((f) => new Moment(first.header, f)) };
}
