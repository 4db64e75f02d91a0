// A server with a stream of the sample room.

import { spawn } from "node:child_process";
import { fileURLToPath } from "node:url";

const SAMPLE = fileURLToPath(new URL("../../../core/roomlight/data/sample", import.meta.url));
const FRAMES_PER_S = "0.8";
const PAUSE_MS = 200; // before the sample starts again

/** Start `roomlight serve` on a free port and stream the sample to it again and again, until `pause` or `stop`. */
export async function sampleStream() {
  const server = spawn("roomlight", ["serve", "--port", "0"], { stdio: ["ignore", "ignore", "pipe"] });
  const url = await addressOf(server);
  let playing;
  let stopped = false;
  const play = () => {
    const how = ["--server", url, "--session", "one", "--keep", "--fps", FRAMES_PER_S, "--pixel", "160,180"];
    playing = spawn("roomlight", ["stream", SAMPLE, ...how], { stdio: "ignore" });
    playing.once("exit", () => stopped || setTimeout(play, PAUSE_MS));
  };
  play();
  const pause = () => {
    stopped = true;
    playing.removeAllListeners("exit").kill();
  };
  const stop = () => {
    pause();
    server.kill();
  };
  process.once("exit", stop);
  return { url, pause, stop };
}

/** The address that the server prints when it listens. */
function addressOf(server) {
  return new Promise((resolve, reject) => {
    let printed = "";
    server.stderr.on("data", (chunk) => {
      printed += chunk; // also afterwards, so that the server can write
      const address = /http:\/\/[\w.:]+/.exec(printed);
      if (address) {
        resolve(`${address[0]}/`);
      }
    });
    server.once("error", () => reject(new Error("roomlight is not in PATH: activate its environment, or give a URL")));
    server.once("exit", (code) => reject(new Error(`roomlight serve ended with ${code}: ${printed}`)));
  });
}
