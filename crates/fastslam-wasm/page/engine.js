"use strict";
/* The filter: requests as JSON, answers as numbers, JSON or an error. */

class Engine {
  static async from(bytes) {
    const { instance } = await WebAssembly.instantiate(bytes, {});
    return new Engine(instance.exports);
  }

  constructor(exports) {
    this.exports = exports;
  }

  /* Sections of a drawing (Float64Array each), or the value of any other answer. Throws what the filter refuses. */
  ask(ask, request = {}) {
    const text = new TextEncoder().encode(JSON.stringify({ ask, ...request }));
    const place = this.exports.fastslam_room(text.length);
    new Uint8Array(this.exports.memory.buffer, place, text.length).set(text);
    const kind = this.exports.fastslam_answer();
    const start = this.exports.fastslam_answer_place(), bytes = this.exports.fastslam_answer_bytes();
    if (kind === 0) return Engine.sections(new Float64Array(this.exports.memory.buffer, start, bytes / 8));
    const answer = new TextDecoder().decode(new Uint8Array(this.exports.memory.buffer, start, bytes));
    if (kind === 2) throw new Error(answer);
    return JSON.parse(answer);
  }

  static sections(numbers) {
    const found = [];
    let at = 1 + numbers[0];
    for (let i = 1; i <= numbers[0]; i++) {
      found.push(numbers.slice(at, at + numbers[i]));
      at += numbers[i];
    }
    return found;
  }
}

if (typeof module !== "undefined") module.exports = { Engine };
