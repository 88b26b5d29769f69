// The operator's hand: one pose that mouse, keys, gamepad or headset move, said to the server sixty times a second.

import * as THREE from "three";

const PERIOD = 16; // [ms]; by a timer, since animation frames become rare when drawing is slow
const FASTEST = 0.8; // [m/s]
const FASTEST_TURN = 3.0; // [rad/s]

export class Hand {
  constructor(socket) {
    this.socket = socket;
    this.position = new THREE.Vector3();
    this.turn = new THREE.Quaternion();
    this.goal = { position: new THREE.Vector3(), turn: new THREE.Quaternion() };
    this.start = { hand: new THREE.Vector3(), tool: new THREE.Vector3() };
    this.source = null; // who holds the arm: the first that took hold, until it lets go
    this.pressed = [];
    this.scale = 1;
    this.tool = null;
    this.moves = []; // called before every message with the time since the last one [s]
    this.drives = false;
    this.last = performance.now();
    this.timer = setInterval(() => this.say(), PERIOD);
    addEventListener("visibilitychange", () => this.look());
    addEventListener("pagehide", () => this.goAway());
    addEventListener("blur", () => this.letGo(this.source));
  }

  // Where the tool is led now: a hand that takes hold begins there.
  follow(target) {
    this.tool = target;
    if (this.source === null) this.rest();
  }

  rest() {
    if (!this.tool) return;
    const [x, y, z, w, i, j, k] = this.tool;
    this.position.set(x, y, z);
    this.turn.set(i, j, k, w).normalize();
    this.goal.position.copy(this.position);
    this.goal.turn.copy(this.turn);
  }

  takeHold(source) {
    if (this.source !== null || !this.tool || !this.drives || document.hidden) return this.source === source;
    this.rest();
    this.source = source;
    this.start.hand.copy(this.position);
    this.start.tool.copy(this.position);
    this.say();
    return true;
  }

  letGo(source) {
    if (source === null || this.source !== source) return;
    this.source = null;
    this.say();
    this.rest();
  }

  // A change of scale while the arm is held couples the hand again where it is.
  rescale(scale) {
    if (scale === this.scale) return;
    this.start.tool.copy(this.mapped());
    this.start.hand.copy(this.position);
    this.scale = scale;
  }

  // Where the tool will be for the hand as it is.
  mapped() {
    if (this.source === null) return this.position.clone();
    return this.position.clone().sub(this.start.hand).multiplyScalar(this.scale).add(this.start.tool);
  }

  press(name) {
    if (!this.drives) return;
    this.pressed.push(name);
    this.say();
  }

  goAway() {
    this.letGo(this.source);
    this.socket.send({ kind: "away" });
  }

  look() {
    if (document.hidden) this.goAway();
  }

  say() {
    const now = performance.now();
    const elapsed = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    if (!this.tool || !this.drives || document.hidden) return;
    for (const move of this.moves) move(elapsed);
    if (this.source !== null && this.source !== "xr") this.approachGoal(elapsed);
    const { position: p, turn: q } = this;
    const norm = Math.hypot(q.w, q.x, q.y, q.z);
    const sent = this.socket.send({
      kind: "hand",
      p: [p.x, p.y, p.z],
      q: [q.w / norm, q.x / norm, q.y / norm, q.z / norm],
      engaged: this.source !== null,
      pressed: this.pressed.slice(0, 8),
      time: now / 1000,
    });
    if (sent) this.pressed.splice(0, 8);
  }

  // The hand goes to where the mouse is no faster than a hand would, so that nothing takes it for a jump.
  approachGoal(elapsed) {
    const step = this.goal.position.clone().sub(this.position);
    const most = FASTEST * elapsed;
    if (step.length() > most) step.setLength(most);
    this.position.add(step);
    const angle = this.turn.angleTo(this.goal.turn);
    if (angle > 1e-6) this.turn.slerp(this.goal.turn, Math.min(1, (FASTEST_TURN * elapsed) / angle));
  }
}
