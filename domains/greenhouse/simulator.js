// The greenhouse as a program of its own: an example of an environment in JavaScript (Node.js).
//
// It speaks the protocol of docs/environments.md, and does what simulator.py does.
"use strict";

let slip, pots, first, atoms, chance;

// Numbers between 0 and 1 that follow from a seed (a Lehmer generator).
function seeded(seed) {
  let x = BigInt(seed % 4294967290) + 1n;
  const next = () => {
    x = (x * 279470273n) % 4294967291n;
    return Number(x) / 4294967291;
  };
  for (let i = 0; i < 4; i++) next();
  return next;
}

// A number about a mean, with about this standard deviation.
function about(mean, deviation) {
  let sum = -6;
  for (let i = 0; i < 12; i++) sum += chance();
  return mean + deviation * sum;
}

const place = () => [...atoms].find((atom) => atom.startsWith("at(")).slice(3, -1);

// Each action changes the state and gives the seconds that it takes.
const actions = {
  drive(to) {
    if (about(1, slip) > 0.6) {
      atoms.delete(`at(${place()})`);
      atoms.add(`at(${to})`);
    }
    return 8;
  },
  fill() {
    atoms.add("full");
    return 5;
  },
  pour() {
    const pot = place();
    if (atoms.has("full") && pots.has(pot)) {
      atoms.delete("full");
      if (about(0.9, 0.1) > 0.75) atoms.delete(`dry(${pot})`);
    }
    return 3;
  },
};

const state = () => [...atoms].sort();

function answer(request) {
  switch (request.type) {
    case "hello":
      slip = request.options.slip ?? 0.15;
      pots = new Set(
        Object.keys(request.objects).filter((name) => request.objects[name].types.includes("pot")),
      );
      first = request.init;
      return { type: "hello", protocol: 1, name: "greenhouse in JavaScript" };
    case "reset":
      atoms = new Set(request.state ?? first);
      chance = seeded(request.seed);
      return { type: "state", state: state() };
    case "execute": {
      const duration = actions[request.action](...request.arguments);
      return { type: "execution", state: state(), duration };
    }
    case "state":
      return { type: "state", state: state() };
    default:
      return { type: "error", message: `what is ${request.type}?` };
  }
}

require("readline")
  .createInterface({ input: process.stdin })
  .on("line", (line) => {
    const request = JSON.parse(line);
    if (request.type === "close") process.exit(0);
    process.stdout.write(JSON.stringify(answer(request)) + "\n");
  })
  .on("close", () => process.exit(0));
