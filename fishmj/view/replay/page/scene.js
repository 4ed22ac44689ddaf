// The water, the tank and its light, in MeshCat's scene tree. World: x, y in the plane, z up, metres.
const THREE = MeshCat.THREE;
const data = JSON.parse(document.getElementById("data").textContent);
const DEPTH = -0.42, SURFACE = 0.17;  // m; drawn floor and water surface, the fish swims at z = 0

function decode(text, Kind) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new Kind(bytes.buffer);
}

const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));

function put(path, object) {
  viewer.set_object(path.split("/"), object);
  return object;
}

function tileTexture() {
  const size = 1024, canvas = document.createElement("canvas");  // 1 m of floor, 4 x 4 tiles
  canvas.width = canvas.height = size;
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#1d6c86";
  pen.fillRect(0, 0, size, size);
  const step = size / 4;
  let seed = 7;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) {
    pen.fillStyle = `rgba(${random() > .5 ? "255,255,255" : "0,30,60"},${0.05 * random()})`;
    pen.fillRect(i * step, j * step, step, step);
  }
  pen.strokeStyle = "rgba(225,245,250,.30)";
  pen.lineWidth = 3;
  for (let i = 0; i <= 4; i++) {
    pen.beginPath(); pen.moveTo(i * step, 0); pen.lineTo(i * step, size); pen.moveTo(0, i * step); pen.lineTo(size, i * step); pen.stroke();
  }
  pen.strokeStyle = "rgba(240,252,255,.75)";
  pen.lineWidth = 9;
  pen.strokeRect(0, 0, size, size);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = 8;
  return texture;
}

// Centre of all paths: the tank is drawn around it, so that a fish far down a channel still swims in water.
function middle() {
  let box = [1e9, -1e9, 1e9, -1e9];
  for (const track of data.tracks) for (let i = 0; i < track.frames; i++) {
    for (const [x, y] of [[track.q[i * track.nq], track.q[i * track.nq + 1]], [track.target[2 * i], track.target[2 * i + 1]]]) {
      if (!isFinite(x)) continue;
      box = [Math.min(box[0], x), Math.max(box[1], x), Math.min(box[2], y), Math.max(box[3], y)];
    }
  }
  const half = data.tank / 2;
  const inside = box[0] > -half && box[1] < half && box[2] > -half && box[3] < half;
  const size = inside ? data.tank : Math.ceil(Math.max(box[1] - box[0], box[3] - box[2], 3) + 1);
  return {
    x: inside ? 0 : Math.round((box[0] + box[1]) / 2), y: inside ? 0 : Math.round((box[2] + box[3]) / 2), size,
    focus: [(box[0] + box[1]) / 2, (box[2] + box[3]) / 2], reach: Math.max(box[1] - box[0], box[3] - box[2], 0.8),
  };
}

function buildTank(tank) {
  viewer.set_property(["Background"], "top_color", [0.72, 0.89, 0.95]);
  viewer.set_property(["Background"], "bottom_color", [0.05, 0.26, 0.36]);
  viewer.set_property(["Grid"], "visible", false);
  viewer.set_property(["Axes"], "visible", false);
  viewer.set_property(["Lights", "AmbientLight", "<object>"], "intensity", 0.55);
  viewer.set_property(["Lights", "FillLight", "<object>"], "intensity", 0.15);
  for (const name of ["PointLightNegativeX", "PointLightPositiveX"]) viewer.set_property(["Lights", name, "<object>"], "intensity", 0.12);

  const texture = tileTexture();
  texture.repeat.set(tank.size, tank.size);
  const floor = new THREE.Mesh(
    new THREE.PlaneGeometry(tank.size, tank.size), new THREE.MeshPhongMaterial({map: texture, shininess: 8, specular: 0x113344}));
  floor.position.set(tank.x, tank.y, DEPTH);
  floor.receiveShadow = true;
  put("tank/floor", floor);

  const height = SURFACE - DEPTH + 0.06, walls = new THREE.BoxGeometry(tank.size, tank.size, height);
  const edges = new THREE.LineSegments(
    new THREE.EdgesGeometry(walls), new THREE.LineBasicMaterial({color: 0xe8f8ff, transparent: true, opacity: 0.55}));
  edges.position.set(tank.x, tank.y, DEPTH - 0.015 + height / 2);  // below the floor: equal planes would flicker
  put("tank/edges", edges);
  const glass = new THREE.Mesh(walls, new THREE.MeshBasicMaterial(
    {color: 0x9fd8e8, transparent: true, opacity: 0.10, side: THREE.BackSide, depthWrite: false}));
  glass.position.copy(edges.position);
  put("tank/glass", glass);

  const sun = new THREE.DirectionalLight(0xfff4e0, 0.62);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, {left: -0.8, right: 0.8, top: 0.8, bottom: -0.8, near: 0.1, far: 6});
  sun.shadow.bias = -0.002;
  sun.shadow.radius = 5;
  put("Lights/Sun", sun);
  viewer.scene.add(sun.target);
  return sun;
}

// A gently moving surface: heights and normals of three travelling waves.
function buildSurface(tank) {
  const cells = 56, plane = new THREE.PlaneGeometry(tank.size, tank.size, cells, cells);
  const material = new THREE.MeshPhongMaterial({
    color: 0xbfeaf5, transparent: true, opacity: 0.13, shininess: 160, specular: 0xffffff, side: THREE.DoubleSide, depthWrite: false});
  const surface = put("water/surface", new THREE.Mesh(plane, material));
  surface.position.set(tank.x, tank.y, SURFACE);
  surface.renderOrder = 5;
  const p = plane.attributes.position, n = plane.attributes.normal;
  const waves = [[9, 3, 2.1], [-5, 8, 1.7], [3, -13, 2.6]];
  return function (t) {
    for (let i = 0; i < p.count; i++) {
      const x = p.getX(i), y = p.getY(i);
      let z = 0, gx = 0, gy = 0;
      for (const [kx, ky, w] of waves) {
        const phase = kx * x + ky * y - w * t, slope = 0.0022 * Math.cos(phase);
        z += 0.0022 * Math.sin(phase); gx += kx * slope; gy += ky * slope;
      }
      p.setZ(i, z);
      n.setXYZ(i, -gx, -gy, 1);
    }
    p.needsUpdate = n.needsUpdate = true;
  };
}

function arrowMesh(colour, opacity) {  // unit arrow along x, flat, 1 m long at scale 1
  const shape = new THREE.Shape();
  [[-.5, -.07], [.12, -.07], [.12, -.2], [.5, 0], [.12, .2], [.12, .07], [-.5, .07]].forEach(
    ([x, y], i) => i ? shape.lineTo(x, y) : shape.moveTo(x, y));
  return new THREE.Mesh(new THREE.ShapeGeometry(shape), new THREE.MeshBasicMaterial(
    {color: colour, transparent: true, opacity, side: THREE.DoubleSide, depthWrite: false}));
}

// The mean current: arrows on the floor and streaks that drift with the logged water.
function buildFlow(tank, track) {
  const [ux, uy] = track.meanFlow, speed = Math.hypot(ux, uy);
  if (!(speed > 1e-3)) return () => {};
  const group = put("water/arrows", new THREE.Group()), count = 7, pitch = tank.size / count;
  for (let i = 0; i < count; i++) for (let j = 0; j < count; j++) {
    const arrow = arrowMesh(0xe9fbff, 0.34);
    arrow.position.set(tank.x + (i - (count - 1) / 2) * pitch, tank.y + (j - (count - 1) / 2) * pitch, DEPTH + 0.012);
    arrow.rotation.z = Math.atan2(uy, ux);
    arrow.scale.set(Math.min(0.45, 1.3 * speed + 0.04), 0.3, 1);
    group.add(arrow);
  }
  const n = 260, base = new Float32Array(3 * n), points = new Float32Array(6 * n), drift = new Float32Array(2 * track.frames);
  let seed = 11;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let i = 0; i < n; i++) base.set([random() * tank.size, random() * tank.size, DEPTH + 0.1 + (SURFACE - DEPTH - 0.14) * random()], 3 * i);
  const dt = track.duration / (track.frames - 1);
  for (let f = 1; f < track.frames; f++) {
    drift[2 * f] = drift[2 * f - 2] + track.flow[2 * f - 2] * dt;
    drift[2 * f + 1] = drift[2 * f - 1] + track.flow[2 * f - 1] * dt;
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
  const streaks = put("water/streaks", new THREE.LineSegments(
    geometry, new THREE.LineBasicMaterial({color: 0xffffff, transparent: true, opacity: 0.5})));
  streaks.frustumCulled = false;
  const wrap = v => ((v % tank.size) + tank.size) % tank.size - tank.size / 2;
  return function (frame) {
    const f = Math.min(Math.round(frame), track.frames - 1), dx = drift[2 * f], dy = drift[2 * f + 1];
    const vx = track.flow[2 * f], vy = track.flow[2 * f + 1];
    for (let i = 0; i < n; i++) {
      const x = tank.x + wrap(base[3 * i] + dx), y = tank.y + wrap(base[3 * i + 1] + dy), z = base[3 * i + 2];
      points.set([x, y, z, x - 0.35 * vx, y - 0.35 * vy, z], 6 * i);
    }
    geometry.attributes.position.needsUpdate = true;
  };
}
