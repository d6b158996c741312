"use strict";
/* Asks the filter without a page: `node ask.cjs fastslam.wasm` reads requests, one JSON object a line, and writes answers. */
const { readFileSync } = require("node:fs");
const { Engine } = require("./engine.js");

Engine.from(readFileSync(process.argv[2])).then((engine) => {
  for (const line of readFileSync(0, "utf8").split("\n").filter((text) => text.trim() !== "")) {
    const { ask, ...request } = JSON.parse(line);
    let answer;
    try {
      answer = { answer: engine.ask(ask, request) };
    } catch (error) {
      answer = { error: error.message };
    }
    console.log(JSON.stringify(answer, (_, value) => value instanceof Float64Array ? [...value] : value));
  }
});
