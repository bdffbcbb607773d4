"""The program of the 3D viewer, which runs in the reader's browser: plain WebGL, no library."""

__all__ = ["SCRIPT"]

# Called as SCRIPT(id, data), with `data` as `viewer.Viewer.payload` makes it. Positions are
# fractions of a cube, 0 to 1. The still picture stays unless a canvas can take its place, and
# comes back if the browser drops the canvas.
SCRIPT = r"""(function (id, data) {
  'use strict';
  var VERTEX = 'attribute vec3 position; attribute vec3 colour; uniform mat4 matrix;' +
    'uniform vec2 shift; uniform float size; varying vec3 tint; void main() {' +
    'gl_Position = matrix * vec4(position, 1.0); gl_PointSize = size / gl_Position.w;' +
    'gl_Position.xy += shift * gl_Position.w; tint = colour; }';
  var FRAGMENT = 'precision mediump float; varying vec3 tint; uniform int shape; void main() {' +
    'vec2 p = gl_PointCoord - 0.5;' +
    'if (shape == 1 && length(p) > 0.5) discard;' +
    'if (shape == 3 && abs(p.x) + abs(p.y) > 0.5) discard;' +
    'if (shape == 4 && 2.0 * abs(p.x) > gl_PointCoord.y) discard;' +
    'gl_FragColor = vec4(tint, 1.0); }';
  var FOCAL = 2.2;

  function bytes(text) {
    var raw = atob(text), result = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) result[i] = raw.charCodeAt(i);
    return result;
  }

  function start(box) {
    var still = box.querySelector('img'), canvas = document.createElement('canvas');
    var gl = canvas.getContext('webgl', {antialias: true, preserveDrawingBuffer: true});
    if (!gl) return;
    box.setAttribute('data-live', '');
    // One finger that moves up or down scrolls the page: the figure may be as wide as a phone.
    canvas.style.cssText = 'display:block;width:100%;height:min(420px,70vh);touch-action:pan-y;' +
      'cursor:grab';
    canvas.tabIndex = 0;
    canvas.setAttribute('data-lm-suppress-shortcuts', '');  // JupyterLab leaves us our keys
    canvas.setAttribute('aria-keyshortcuts', 'ArrowLeft ArrowRight ArrowUp ArrowDown + - 0');
    canvas.setAttribute('role', 'img');
    canvas.setAttribute('aria-label', still.alt);

    function compile(kind, source) {
      var shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    function buffer(array) {
      var made = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, made);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
      return made;
    }
    var signs = document.createElement('div');  // the letters of axes, over the canvas
    signs.setAttribute('aria-hidden', 'true');
    signs.style.cssText = 'position:absolute;overflow:hidden;pointer-events:none';
    function letters(part, positions) {
      var made = [];
      for (var i = 0; i < positions.length && positions.length <= 120; i += 6) {
        var sign = document.createElement('span'), place = [];
        for (var j = 0; j < 3; j++)
          place.push((1.12 * positions[i + 3 + j] - 0.12 * positions[i + j]) / 65535);
        sign.textContent = part.label;
        sign.style.cssText = 'position:absolute;font:bold 14px sans-serif;' +
          'transform:translate(-50%,-50%);color:rgb(' + part.colour + ')';
        signs.append(sign);
        made.push({place: place, sign: sign});
      }
      return made;
    }
    var program = gl.createProgram();
    compile(gl.VERTEX_SHADER, VERTEX);
    compile(gl.FRAGMENT_SHADER, FRAGMENT);
    gl.bindAttribLocation(program, 0, 'position');
    gl.bindAttribLocation(program, 1, 'colour');
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return;
    gl.useProgram(program);
    gl.enableVertexAttribArray(0);
    var where = {};
    ['matrix', 'shift', 'size', 'shape'].forEach(function (name) {
      where[name] = gl.getUniformLocation(program, name);
    });
    var parts = data.parts.map(function (part) {
      var positions = new Uint16Array(bytes(part.positions).buffer);
      return {
        count: positions.length / 3, lines: part.lines, onTop: part.onTop,
        marker: part.marker, shown: true,
        positions: buffer(positions), colour: part.colour,
        colours: part.colours ? buffer(bytes(part.colours)) : null,
        letters: part.onTop ? letters(part, positions) : []
      };
    });

    var azimuth, elevation, distance, waiting = false;
    function reset() {
      azimuth = data.azimuth; elevation = data.elevation;
      distance = 0.95 * data.radius * Math.sqrt(1 + FOCAL * FOCAL);
    }
    function ink() {  // the colour of the page's text, which follows its light or dark theme
      return getComputedStyle(box).color.match(/[\d.]+/g).slice(0, 3).map(Number);
    }
    function matrix(aspect) {
      var ca = Math.cos(azimuth), sa = Math.sin(azimuth);
      var ce = Math.cos(elevation), se = Math.sin(elevation);
      var rows = [[-sa, ca, 0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]];
      if (data.up === '-y') rows = rows.map(function (v) { return [v[0], -v[2], v[1]]; });
      var f = FOCAL * Math.min(1, aspect), near = 0.05, far = distance + 4, m = [];
      var a = (far + near) / (near - far), b = 2 * far * near / (near - far);
      // The cube 0..1 becomes -1..1: columns are doubled, and its middle is the origin.
      for (var j = 0; j < 3; j++) m.push(2 * f * rows[0][j] / aspect, 2 * f * rows[1][j],
        2 * a * rows[2][j], -2 * rows[2][j]);
      var o = rows.map(function (v) { return -(v[0] + v[1] + v[2]); });
      m.push(f * o[0] / aspect, f * o[1], a * (o[2] - distance) + b, distance - o[2]);
      return new Float32Array(m);
    }
    var rim = ['2px 0', '-2px 0', '0 2px', '0 -2px', '1px 1px', '-1px 1px', '1px -1px',
      '-1px -1px'];
    function letter(part, m, halo) {
      part.letters.forEach(function (one) {
        var p = one.place, at = [0, 1, 2, 3].map(function (i) {
          return m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i];
        });
        one.sign.style.display = part.shown && at[3] > 0 ? '' : 'none';
        one.sign.style.left = 50 * (1 + at[0] / at[3]) + '%';
        one.sign.style.top = 50 * (1 - at[1] / at[3]) + '%';
        one.sign.style.textShadow = rim.map(function (shift) {
          return shift + ' 0 rgb(' + halo + ')';
        }).join(',');
      });
    }
    function draw() {
      waiting = false;
      var ratio = window.devicePixelRatio || 1, text = ink();
      // A rim around axes, light in a light theme, so that they are seen before any cloud.
      var halo = text[0] + text[1] + text[2] < 384 ? [255, 255, 255] : [0, 0, 0];
      canvas.width = Math.max(1, canvas.clientWidth * ratio);
      canvas.height = Math.max(1, canvas.clientHeight * ratio);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      var m = matrix(canvas.width / canvas.height);
      gl.uniformMatrix4fv(where.matrix, false, m);
      gl.uniform1f(where.size, data.size * canvas.height);
      signs.style.left = canvas.offsetLeft + 'px';
      signs.style.top = canvas.offsetTop + 'px';
      signs.style.width = canvas.clientWidth + 'px';
      signs.style.height = canvas.clientHeight + 'px';
      parts.forEach(function (part) {
        letter(part, m, halo);
        if (!part.shown) return;
        gl.bindBuffer(gl.ARRAY_BUFFER, part.positions);
        gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
        var c = part.colour || text;
        if (part.colours) {
          gl.enableVertexAttribArray(1);
          gl.bindBuffer(gl.ARRAY_BUFFER, part.colours);
          gl.vertexAttribPointer(1, 3, gl.UNSIGNED_BYTE, true, 0, 0);
        } else {
          gl.disableVertexAttribArray(1);
          gl.vertexAttrib3f(1, c[0] / 255, c[1] / 255, c[2] / 255);
        }
        (part.onTop ? gl.disable : gl.enable).call(gl, gl.DEPTH_TEST);
        gl.uniform1i(where.shape, part.lines ? 0 : 1 + part.marker);
        var reach = part.lines ? Math.round(ratio) * (part.onTop ? 2 : 1) || 1 : 0;
        if (part.onTop) {
          gl.vertexAttrib3f(1, halo[0] / 255, halo[1] / 255, halo[2] / 255);
          stroke(part, reach + Math.max(2, Math.round(2 * ratio)));
          gl.vertexAttrib3f(1, c[0] / 255, c[1] / 255, c[2] / 255);
        }
        stroke(part, reach);
      });
    }
    // WebGL draws lines one pixel wide: a few of them side by side make a thicker one.
    function stroke(part, reach) {
      for (var dx = -reach; dx <= reach; dx++) for (var dy = -reach; dy <= reach; dy++) {
        if (Math.abs(dx) + Math.abs(dy) > reach) continue;
        gl.uniform2f(where.shift, dx / canvas.width, dy / canvas.height);
        gl.drawArrays(part.lines ? gl.LINES : gl.POINTS, 0, part.count);
      }
    }
    function later() {
      watch(canvas.isConnected);
      if (canvas.isConnected && !waiting) { waiting = true; requestAnimationFrame(draw); }
    }
    function turn(dx, dy) {
      azimuth -= dx * 0.01;
      elevation = Math.max(-1.55, Math.min(1.55, elevation + dy * 0.01));
      later();
    }
    function zoom(factor) {
      distance = Math.max(0.3, Math.min(40, distance * factor));
      later();
    }

    var fingers = {};
    function spread() {
      var f = Object.keys(fingers).map(function (key) { return fingers[key]; });
      return f.length === 2 ? Math.hypot(f[0][0] - f[1][0], f[0][1] - f[1][1]) : 0;
    }
    canvas.addEventListener('pointerdown', function (event) {
      fingers[event.pointerId] = [event.clientX, event.clientY];
      try { canvas.setPointerCapture(event.pointerId); } catch (error) { /* a pointer that left */ }
    });
    canvas.addEventListener('pointermove', function (event) {
      var last = fingers[event.pointerId], before = spread();
      if (!last) return;
      fingers[event.pointerId] = [event.clientX, event.clientY];
      if (before) zoom(before / Math.max(1, spread()));
      else turn(event.clientX - last[0], event.clientY - last[1]);
    });
    ['pointerup', 'pointercancel'].forEach(function (name) {
      canvas.addEventListener(name, function (event) { delete fingers[event.pointerId]; });
    });
    canvas.addEventListener('wheel', function (event) {
      // The wheel alone scrolls the page. A pinch on a touchpad comes as a wheel with Ctrl.
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      zoom(Math.exp(event.deltaY * (event.deltaMode ? 0.03 : 0.002)));  // lines or pixels
    }, {passive: false});
    canvas.addEventListener('dblclick', function () { reset(); later(); });
    canvas.addEventListener('keydown', function (event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;  // the browser's own
      var step = {ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, -10], ArrowDown: [0, 10]};
      if (step[event.key]) turn.apply(null, step[event.key]);
      else if (event.key === '+' || event.key === '=') zoom(0.9);
      else if (event.key === '-') zoom(1 / 0.9);
      else if (event.key === '0' || event.key === 'Home') { reset(); later(); }
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    canvas.addEventListener('webglcontextlost', function () {
      watch(false);
      canvas.replaceWith(still);
      signs.remove();
      legend.remove();
    });

    var legend = document.createElement('div');
    legend.style.cssText = 'font-size:13px;text-align:center;line-height:1.8';
    data.parts.forEach(function (part, number) {
      var button = document.createElement('button'), mark = document.createElement('span');
      mark.style.fontWeight = 'bold';
      mark.textContent = part.lines ? '\u2014' : '\u25cf\u25a0\u25c6\u25b2'[part.marker];
      if (part.colour) mark.style.color = 'rgb(' + part.colour + ')';
      button.append(mark, ' ' + part.label);
      button.type = 'button';
      button.title = 'show or hide';
      button.setAttribute('aria-pressed', 'true');
      button.style.cssText = 'border:0;background:none;color:inherit;font:inherit;cursor:pointer;' +
        'padding:0 8px';
      button.addEventListener('click', function () {
        parts[number].shown = !parts[number].shown;
        button.setAttribute('aria-pressed', parts[number].shown);
        button.style.opacity = parts[number].shown ? 1 : 0.4;
        later();
      });
      legend.append(button);
    });
    var hint = document.createElement('div');
    hint.textContent = data.hint;
    hint.style.opacity = 0.7;
    legend.append(hint);

    // The page's theme is watched only while the figure is on the page: an output that a notebook
    // has thrown away must not be held, with its share of the graphics memory, by the page.
    var themes = new MutationObserver(later), watching = false;
    var dark = matchMedia('(prefers-color-scheme: dark)');
    function watch(on) {
      if (on === watching) return;
      watching = on;
      dark[on ? 'addEventListener' : 'removeEventListener']('change', later);
      if (!on) return themes.disconnect();
      [document.documentElement, document.body].forEach(function (element) {
        themes.observe(element, {attributes: true});
      });
    }

    reset();
    box.style.position = 'relative';
    still.replaceWith(canvas);
    canvas.after(signs);
    box.append(legend);
    new ResizeObserver(later).observe(canvas);
    draw();
  }

  document.querySelectorAll('[id="' + id + '"]:not([data-live])').forEach(start);
})"""
