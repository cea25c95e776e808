// Runs an image for wasm32 under Node.js: node run.mjs IMAGE.
import { readFileSync } from "node:fs";

const printed = [];
const port = {
  put: (byte) => printed.push(byte),
  exit: (status) => {
    process.stdout.write(Buffer.from(printed));
    process.exitCode = status;
  },
};
const { instance } = await WebAssembly.instantiate(readFileSync(process.argv[2]), { port });
instance.exports.run();
