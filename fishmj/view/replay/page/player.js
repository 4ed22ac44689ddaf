// Time, camera and controls. `#t=3.5&play=0&view=top&follow=1&wake=0` in the address sets the start.
const el = id => document.getElementById(id);
const KINDS = {q: "f", target: "f", flow: "f", power: "f", speed: "f", distance: "f"};

for (const track of data.tracks) {
  track.nq = track.links + 2;
  for (const key of Object.keys(KINDS)) track[key] = decode(track[key], Float32Array);
  track.meanFlow = track.meanFlow.map(v => v === null ? NaN : v);
}
const duration = Math.max(...data.tracks.map(track => track.duration));
const frames = Math.max(...data.tracks.map(track => track.frames));
const tank = middle(), sun = buildTank(tank), ripple = buildSurface(tank), stream = buildFlow(tank, data.tracks[0]);
const fishes = data.tracks.map((track, i) => new Fish(i, track, data.skins[i]));
const wake = data.wake && new Wake(data.wake);
const wish = new URLSearchParams(location.hash.slice(1));

const clock = {time: Number(wish.get("t") || 0), speed: data.speed, playing: wish.get("play") !== "0", then: null, followed: null};
const chart = new Chart(el("chart"), data.tracks, duration, seek);

function legend() {
  const safe = text => String(text).replace(/[&<>"]/g, c => `&#${c.charCodeAt(0)};`);
  const fish = data.tracks.map((track, i) => `<div class="fish" style="--colour:${track.colour}"><b>${safe(track.label)}</b>
    <br><small>${safe(track.origin)}, drawn from ${safe(track.source)}</small>
    <dl><dt>distance</dt><dt>speed</dt><dt>power</dt><dd id="d${i}"></dd><dd id="s${i}"></dd><dd id="p${i}"></dd></dl></div>`).join("");
  const [ux, uy] = data.tracks[0].meanFlow, speed = Math.hypot(ux, uy);
  const water = speed < 1e-3 ? "still water" : isFinite(speed) ? `current ${speed.toFixed(2)} m/s towards ${Math.round(Math.atan2(uy, ux) * 180 / Math.PI)}&deg;` : "current not in the log";
  el("legend").innerHTML = `<h1>${safe(data.title)}</h1>${fish}<div class="marks">
    ${chart.aimed ? `<i style="background:#ff9d2e"></i>target, ring ${data.arrival} m (green inside)<br>` : ""}
    <i style="background:#7ef0ff"></i>water at the fish<br><i style="background:#e9fbff"></i>${water}<br>
    <i class="tile"></i>floor tiles 0.25 m</div>${wake ? wake.legend() : ""}`;
}

function seek(time) {
  clock.time = Math.min(duration, Math.max(0, time));
  show();
}

function play(on) {
  clock.playing = on;
  el("play").innerHTML = on ? "&#10074;&#10074;" : "&#9654;";
}

function show() {
  fishes.forEach((fish, i) => {
    const track = fish.track, frame = Math.min(clock.time, track.duration) / track.duration * (track.frames - 1);
    fish.move(frame);
    const number = (array, unit, digits) => { const v = fish.at(array, 1, frame, 0); return isFinite(v) ? v.toFixed(digits) + unit : "–"; };
    el("d" + i).textContent = number(track.distance, " m", 2);
    el("d" + i).className = fish.at(track.distance, 1, frame, 0) <= data.arrival ? "in" : "";
    el("s" + i).textContent = number(track.speed, " m/s", 2);
    el("p" + i).textContent = number(track.power, " W", 1);
  });
  const first = fishes[0], x = first.state[0], y = first.state[1];
  sun.position.set(x + 0.25, y - 0.2, 2.2);
  sun.target.position.set(x, y, 0);
  stream(clock.time / first.track.duration * (first.track.frames - 1));
  ripple(clock.time);
  if (wake) wake.show(clock.time);
  follow(x, y);
  chart.cursor(clock.time);
  el("time").value = clock.time;
  el("clock").textContent = `${clock.time.toFixed(2)} / ${duration.toFixed(1)} s`;
  viewer.set_dirty();
}

// MeshCat's camera lives in three.js axes (y up): world (x, y, z) -> (x, z, -y).
const inThree = (x, y, z) => new THREE.Vector3(x, z, -y);

function follow(x, y) {
  const spot = inThree(x, y, 0);
  if (el("follow").checked && clock.followed) {
    const step = spot.clone().sub(clock.followed);
    viewer.camera.position.add(step);
    viewer.controls.target.add(step);
  }
  clock.followed = spot;
}

const VIEWS = {
  "3-D": (x, y, reach) => [inThree(x - 0.18 * reach, y - 0.78 * reach, 0.62 * reach), inThree(x, y - 0.05 * reach, -0.06)],
  top: (x, y, reach) => [inThree(x, y - 0.001, 1.35 * reach), inThree(x, y, 0)],
  side: (x, y, reach) => [inThree(x, y - 1.15 * reach, 0.1), inThree(x, y, -0.05)],
  near: () => { const s = fishes[0].state; return [inThree(s[0] - 0.15, s[1] - 0.62, 0.42), inThree(s[0] - 0.05, s[1], 0)]; },
};

function look(name) {
  const wide = Math.max(1.15, 1.1 * tank.reach), [eye, centre] = VIEWS[name](tank.focus[0], tank.focus[1], wide);
  const back = Math.max(1, 1.7 * innerHeight / innerWidth);  // the angle of view is that of the height: a narrow window sees less
  viewer.camera.position.copy(eye.sub(centre).multiplyScalar(back).add(centre));
  viewer.controls.target.copy(centre);
  viewer.controls.update();
  if (name === "near") el("follow").checked = true;
  viewer.set_dirty();
}

function buttons(place, names, act, chosen) {
  names.forEach(name => {
    const button = document.createElement("button");
    button.textContent = name;
    button.addEventListener("click", () => {
      [...el(place).children].forEach(other => other.classList.toggle("on", other === button));
      act(name);
    });
    button.classList.toggle("on", name === chosen);
    el(place).append(button);
  });
}

function tick(now) {
  const step = clock.then === null ? 0 : Math.min(now - clock.then, 100) / 1000;
  clock.then = now;
  if (clock.playing) seek(clock.time + step * clock.speed >= duration ? 0 : clock.time + step * clock.speed);
  requestAnimationFrame(tick);
}

viewer.camera.fov = 50;
viewer.camera.updateProjectionMatrix();
legend();
el("time").max = duration;
el("time").addEventListener("input", event => { play(false); seek(Number(event.target.value)); });
el("play").addEventListener("click", () => play(!clock.playing));
const speeds = [...new Set([0.25, 0.5, 1, 2, 4, data.speed])].sort((a, b) => a - b);
buttons("speeds", speeds.map(s => s + "x"), name => { clock.speed = parseFloat(name); }, data.speed + "x");
const view = VIEWS[wish.get("view")] ? wish.get("view") : wake ? "near" : "3-D";
buttons("views", Object.keys(VIEWS), look, view);
document.addEventListener("keydown", event => {
  const act = {" ": () => play(!clock.playing), ArrowLeft: () => seek(clock.time - 0.1), ArrowRight: () => seek(clock.time + 0.1), f: () => el("follow").click(), v: () => el("wake").click()}[event.key];
  if (act && event.target.type !== "range") { event.preventDefault(); act(); }
});
el("sheet").hidden = !wake;
el("wake").addEventListener("change", () => { if (wake) wake.plane.visible = el("wake").checked; viewer.set_dirty(); });
if (wake && wish.get("wake") === "0") el("wake").click();
play(clock.playing);
el("follow").checked = wish.get("follow") === "1";
seek(clock.time);
look(view);
if (wake) wake.loaded.then(() => { document.body.dataset.wake = `${wake.t.length} slices`; });
requestAnimationFrame(() => requestAnimationFrame(now => {
  document.body.dataset.ready = `ready: ${frames} frames`;
  tick(now);
}));
