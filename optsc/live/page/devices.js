// Held keys and gamepads: both push the hand while they are held, seen from where the person looks.

import * as THREE from "three";

const SPEED = 0.16; // [m/s]
const TURN = 0.8; // [rad/s]
const RISE = 0.12; // time in which a push comes in [s]
const HOLD = 0.6; // a button that is pressed so far takes hold ...
const LET_GO = 0.4; // ... and lets go below this: a finger that trembles in between changes nothing
const DEAD = 0.15;

const AXES = {
  KeyW: [0, 1], KeyS: [0, -1], KeyD: [1, 1], KeyA: [1, -1], KeyE: [2, 1], KeyQ: [2, -1],
  KeyI: [3, -1], KeyK: [3, 1], KeyL: [4, 1], KeyJ: [4, -1], KeyO: [5, 1], KeyU: [5, -1],
};
export const PAD_BUTTONS = { 0: "TRIGGER", 1: "CANCEL", 2: "NEXT", 3: "RELEASE", 9: "CONFIRM", 8: "VETO", 5: "PLACE" };

// Moves the goal of a hand by pushes (forward, right, up; pitch, yaw, roll), each -1 to 1.
class Pusher {
  constructor(view, hand, source) {
    Object.assign(this, { view, hand, source, share: 0 });
  }

  push(pushes, elapsed) {
    this.share = Math.min(1, this.share + elapsed / RISE);
    const camera = this.view.camera.quaternion;
    const right = new THREE.Vector3(1, 0, 0).applyQuaternion(camera).setZ(0).normalize();
    const up = new THREE.Vector3(0, 0, 1);
    const forward = up.clone().cross(right);
    const [f, r, u, pitch, yaw, roll] = pushes;
    const step = forward.clone().multiplyScalar(f).addScaledVector(right, r).addScaledVector(up, u);
    if (step.length() > 1) step.normalize();
    this.hand.goal.position.addScaledVector(step, (SPEED * this.share * elapsed) / this.hand.scale);
    const about = right.clone().multiplyScalar(pitch).addScaledVector(up, -yaw).addScaledVector(forward, roll);
    const angle = about.length();
    if (angle > 0) {
      const turn = new THREE.Quaternion().setFromAxisAngle(about.normalize(), TURN * this.share * Math.min(1, angle) * elapsed);
      this.hand.goal.turn.premultiply(turn);
    }
  }

  release() {
    this.share = 0;
    this.hand.letGo(this.source);
  }
}

export class Keys {
  constructor(view, hand, shortcuts) {
    this.pusher = new Pusher(view, hand, "keys");
    this.held = new Set();
    addEventListener("keydown", (event) => {
      const typing = event.target instanceof HTMLSelectElement || event.target.type === "text";
      if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.code in AXES) this.held.add(event.code);
      else if (event.code in shortcuts) {
        if (!event.repeat) shortcuts[event.code]();
      } else return;
      event.preventDefault();
      document.activeElement.blur?.();
    });
    addEventListener("keyup", (event) => this.held.delete(event.code));
    addEventListener("blur", () => this.held.clear());
    addEventListener("visibilitychange", () => this.held.clear());
    hand.moves.push((elapsed) => this.move(elapsed));
    this.hand = hand;
  }

  move(elapsed) {
    if (this.held.size === 0) {
      if (this.hand.source === "keys") this.pusher.release();
      return;
    }
    if (this.hand.source !== "keys") {
      if (this.hand.source === null && !this.taking) {
        this.taking = true; // taking hold says so at once, which asks for moves again
        this.hand.takeHold("keys");
        this.taking = false;
      }
      if (this.hand.source !== "keys") return;
    }
    const pushes = [0, 0, 0, 0, 0, 0];
    for (const code of this.held) pushes[AXES[code][0]] += AXES[code][1];
    this.pusher.push(pushes, elapsed);
  }
}

function stick(value) {
  const size = Math.abs(value || 0);
  return size < DEAD ? 0 : (Math.sign(value) * (size - DEAD)) / (1 - DEAD);
}

export class Pad {
  constructor(view, hand) {
    this.pusher = new Pusher(view, hand, "pad");
    this.hand = hand;
    this.down = {};
    this.holding = false;
    hand.moves.push((elapsed) => this.move(elapsed));
  }

  get pad() {
    return [...(navigator.getGamepads?.() || [])].find((pad) => pad && pad.connected) || null;
  }

  move(elapsed) {
    const pad = this.pad;
    if (!pad) {
      if (this.holding) this.release();
      return;
    }
    for (const [index, name] of Object.entries(PAD_BUTTONS)) {
      const down = Boolean(pad.buttons[index]?.pressed);
      if (down && !this.down[index]) this.hand.pressed.push(name);
      this.down[index] = down;
    }
    const value = pad.buttons[4]?.value || 0;
    if (!this.holding && value > HOLD && !this.taking) {
      this.taking = true;
      this.holding = this.hand.takeHold("pad");
      this.taking = false;
    } else if (this.holding && value < LET_GO) this.release();
    if (!this.holding || this.hand.source !== "pad") return;
    const [x, y, turn, lift] = [0, 1, 2, 3].map((axis) => stick(pad.axes[axis]));
    const roll = (pad.buttons[7]?.value || 0) - (pad.buttons[6]?.value || 0);
    this.pusher.push([-y, x, -lift, 0, turn, roll], elapsed);
  }

  release() {
    this.holding = false;
    this.pusher.release();
  }

  pulse(strength, duration) {
    this.pad?.vibrationActuator?.playEffect?.("dual-rumble", {
      duration, strongMagnitude: strength, weakMagnitude: strength,
    });
  }
}
