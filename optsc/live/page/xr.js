// Headset and phone (WebXR): the grip of a controller is the hand while its squeeze is held; on a phone, the phone is,
// while a finger is on its screen. A controller that is lost lets go.

import * as THREE from "three";

const HOLD = 0.6;
const LET_GO = 0.4;
const JUMP = 0.12; // further than this from one frame to the next no hand moves, but trackers do [m]
const TABLE = 0.75; // height of the table over the floor [m]
const BUTTONS = { 0: "TRIGGER", 4: "NEXT", 5: "CANCEL" };

export class Headset {
  constructor(view, hand, place) {
    Object.assign(this, { view, hand, holding: null, down: new Map() });
    this.stand(0);
    for (const [mode, text] of [["immersive-vr", "Headset"], ["immersive-ar", "Phone AR"]]) {
      navigator.xr?.isSessionSupported(mode).then((there) => {
        if (!there) return;
        const button = document.createElement("button");
        button.textContent = text;
        button.id = mode;
        button.onclick = () => this.begin(mode);
        place.append(button);
      }).catch(() => {});
    }
  }

  // The person stands behind the arm, looking the way it does; `heading` turns them about the vertical.
  stand(heading) {
    const rig = this.view.rig;
    this.heading = heading;
    this.standing = new THREE.Matrix4()
      .makeRotationZ(heading - Math.PI / 2)
      .multiply(new THREE.Matrix4().makeRotationX(Math.PI / 2));
    this.standing.setPosition(-0.35, 0.45, -TABLE);
    if (this.session) this.apply(rig);
  }

  apply(rig) {
    this.standing.decompose(rig.position, rig.quaternion, rig.scale);
    rig.updateMatrixWorld(true);
  }

  async begin(mode) {
    if (this.session) return;
    const options = { optionalFeatures: ["local-floor", "dom-overlay"], domOverlay: { root: document.getElementById("stage") } };
    this.session = await navigator.xr.requestSession(mode, options);
    this.space = null;
    this.view.controls.enabled = false;
    this.apply(this.view.rig);
    this.view.renderer.xr.setReferenceSpaceType("local-floor");
    await this.view.renderer.xr.setSession(this.session);
    this.space = this.view.renderer.xr.getReferenceSpace();
    const background = this.view.world.background;
    if (mode === "immersive-ar") this.view.world.background = null;
    this.session.addEventListener("end", () => {
      this.letGo();
      this.session = null;
      this.view.world.background = background;
      this.view.rig.position.set(0, 0, 0);
      this.view.rig.quaternion.identity();
      this.view.controls.enabled = true;
      this.view.resize();
      this.view.lookFromTheStart();
    });
  }

  // Called with every frame of a session.
  frame(frame) {
    if (!this.session || !frame || !this.space) return;
    const sources = [...this.session.inputSources];
    if (this.holding && !sources.includes(this.holding)) this.letGo();
    for (const source of sources) {
      if (source.targetRayMode === "screen") this.phone(source, frame);
      else if (source.gamepad) this.controller(source, frame);
    }
  }

  controller(source, frame) {
    const buttons = source.gamepad.buttons;
    const before = this.down.get(source) || {};
    const now = {};
    for (const [index, name] of Object.entries(BUTTONS)) {
      now[index] = Boolean(buttons[index]?.pressed);
      if (now[index] && !before[index]) this.hand.press(name);
    }
    now.stick = Boolean(buttons[3]?.pressed);
    if (now.stick && !before.stick) this.recentre(source, frame);
    this.down.set(source, now);
    const squeeze = buttons[1]?.value ?? 0;
    const pose = source.gripSpace && frame.getPose(source.gripSpace, this.space);
    this.lead(source, pose, squeeze);
  }

  phone(source, frame) {
    this.lead(source, frame.getViewerPose(this.space), 1);
  }

  lead(source, pose, squeeze) {
    // A position that is guessed now and was measured when it took hold means that tracking is lost.
    const tracked = Boolean(pose) && !(pose.emulatedPosition && this.holding === source && !this.guessed);
    const { position, turn } = tracked ? this.inWorld(pose) : {};
    const jumped = tracked && this.seen && this.seen.distanceTo(position) > JUMP;
    if (this.holding === source && (!tracked || jumped || squeeze < LET_GO)) {
      this.letGo();
      return;
    }
    if (!tracked) return;
    if (this.holding === null && squeeze > HOLD && this.hand.takeHold("xr")) {
      this.holding = source;
      this.guessed = Boolean(pose.emulatedPosition);
      // The hand begins at the tool, and moves as the controller does from here.
      this.from = { position: position.clone(), turn: turn.clone() };
      this.at = { position: this.hand.position.clone(), turn: this.hand.turn.clone() };
      this.pulse(0.4, 40);
    }
    if (this.holding !== source) return;
    this.seen = position;
    this.hand.position.copy(position).sub(this.from.position).add(this.at.position);
    this.hand.turn.copy(turn).multiply(this.from.turn.clone().invert()).multiply(this.at.turn);
  }

  inWorld(pose) {
    const { position: p, orientation: q } = pose.transform;
    const rotation = new THREE.Quaternion().setFromRotationMatrix(this.standing);
    return {
      position: new THREE.Vector3(p.x, p.y, p.z).applyMatrix4(this.standing),
      turn: rotation.multiply(new THREE.Quaternion(q.x, q.y, q.z, q.w)),
    };
  }

  // "Forward" becomes where the controller points now.
  recentre(source, frame) {
    this.letGo();
    const pose = frame.getPose(source.targetRaySpace, this.space);
    if (!pose) return;
    const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(this.inWorld(pose).turn);
    this.stand(this.heading - Math.atan2(ahead.y, ahead.x));
  }

  letGo() {
    this.holding = this.seen = null;
    this.hand.letGo("xr");
  }

  pulse(strength, duration) {
    for (const source of this.session?.inputSources || []) {
      source.gamepad?.hapticActuators?.[0]?.pulse?.(strength, duration);
    }
  }
}
