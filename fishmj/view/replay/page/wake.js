// The water of the flow solver: two slices of vorticity, mixed in time, coloured by the table that came with them.
class Wake {
  constructor(wake) {
    Object.assign(this, wake);
    this.textures = this.images.map(() => new THREE.Texture());
    this.loaded = Promise.all(this.images.map((text, i) => {
      const image = new Image(), texture = this.textures[i];
      image.src = "data:image/png;base64," + text;
      Object.assign(texture, {image, generateMipmaps: false, minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter});
      return image.decode().then(() => { this.material.uniforms.cells.value.set(image.width, image.height); texture.needsUpdate = true; viewer.set_dirty(); });
    }));
    const table = new THREE.DataTexture(decode(this.colours, Uint8Array), 256, 1, THREE.RGBAFormat);
    Object.assign(table, {minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter, needsUpdate: true});
    this.material = new THREE.ShaderMaterial({
      transparent: true, depthWrite: false, side: THREE.DoubleSide, vertexShader: Wake.VERTEX, fragmentShader: Wake.FRAGMENT,
      uniforms: {one: {value: null}, two: {value: null}, rectOne: {value: new THREE.Vector4()}, rectTwo: {value: new THREE.Vector4()},
        cells: {value: new THREE.Vector2(1, 1)}, share: {value: 0}, table: {value: table}},
    });
    this.plane = put("water/vorticity", new THREE.Mesh(new THREE.PlaneGeometry(1, 1), this.material));
    this.plane.frustumCulled = false;
    this.plane.renderOrder = -1;  // under trail, arrows and surface
  }

  static VERTEX = `
    varying vec2 place;
    void main() {
      place = (modelMatrix * vec4(position, 1.0)).xz * vec2(1.0, -1.0);  // MeshCat turns the world's z up into three's y up
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`;

  static FRAGMENT = `
    uniform sampler2D one, two, table;
    uniform vec4 rectOne, rectTwo;  // west, south, 1 / width, 1 / height
    uniform float share;
    varying vec2 place;
    uniform vec2 cells;
    float smooth4(sampler2D slice, vec2 uv) {  // cubic B-spline from four linear samples: no diamonds between coarse cells
      vec2 p = uv * cells - 0.5, f = fract(p), i = p - f;
      vec2 w0 = (1.0 - f) * (1.0 - f) * (1.0 - f) / 6.0, w1 = (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0, w3 = f * f * f / 6.0;
      vec2 g0 = w0 + w1, g1 = 1.0 - g0, a = (i - 0.5 + w1 / g0) / cells, b = (i + 1.5 + w3 / g1) / cells;
      return g0.y * (g0.x * texture2D(slice, a).r + g1.x * texture2D(slice, vec2(b.x, a.y)).r)
           + g1.y * (g0.x * texture2D(slice, vec2(a.x, b.y)).r + g1.x * texture2D(slice, b).r);
    }
    vec2 seen(sampler2D slice, vec4 rect) {  // value and weight: edges fade over a fortieth of the slice
      vec2 uv = (place - rect.xy) * rect.zw;
      vec2 room = clamp(min(uv, 1.0 - uv) * 40.0, 0.0, 1.0);
      return vec2((smooth4(slice, uv) * 255.0 - 128.0) / 127.0, smoothstep(0.0, 1.0, room.x) * smoothstep(0.0, 1.0, room.y));
    }
    void main() {
      vec2 a = seen(one, rectOne), b = seen(two, rectTwo);
      float weight = mix(a.y, b.y, share), value = mix(a.x * a.y, b.x * b.y, share) / max(weight, 1e-3);
      vec4 colour = texture2D(table, vec2((value * 127.0 + 128.5) / 256.0, 0.5));
      gl_FragColor = vec4(colour.rgb, colour.a * weight);
    }`;

  show(time) {  // linear between the slices before and after
    const last = this.t.length - 1;
    let i = 0;
    while (i < last - 1 && this.t[i + 1] <= time) i++;
    const k = Math.min(i + 1, last), gap = this.t[k] - this.t[i], uniforms = this.material.uniforms;
    uniforms.share.value = gap > 0 ? Math.min(1, Math.max(0, (time - this.t[i]) / gap)) : 0;
    const box = [Infinity, -Infinity, Infinity, -Infinity];
    [["one", i], ["two", k]].forEach(([name, n]) => {
      const [west, east, south, north] = this.rect[n];
      uniforms[name].value = this.textures[n];
      uniforms[name === "one" ? "rectOne" : "rectTwo"].value.set(west, south, 1 / (east - west), 1 / (north - south));
      box.splice(0, 4, Math.min(box[0], west), Math.max(box[1], east), Math.min(box[2], south), Math.max(box[3], north));
    });
    this.plane.position.set((box[0] + box[1]) / 2, (box[2] + box[3]) / 2, this.z - 0.012);  // a finger below the trail
    this.plane.scale.set(box[1] - box[0], box[3] - box[2], 1);
  }

  legend() {
    const table = decode(this.colours, Uint8Array), stops = [];
    for (let i = 1; i < 256; i += 6) stops.push(`rgb(${table[4 * i]},${table[4 * i + 1]},${table[4 * i + 2]})`);
    const number = v => Number(v.toPrecision(3));
    const ticks = [-1, -0.5, 0, 0.5, 1].map(v => `<span>${v > 0 ? "+" : v < 0 ? "&minus;" : ""}${number(Math.abs(v) * this.strong)}</span>`).join("");
    return `<div class="scale"><b>vorticity &omega;<sub>z</sub></b> <small>1/s, at z = ${this.z.toFixed(2)} m, simulated</small>
      <i style="background:linear-gradient(90deg,${stops.join(",")})"></i><div>${ticks}</div>
      <small><span>clockwise</span><span>counter-clockwise</span></small></div>`;
  }
}
