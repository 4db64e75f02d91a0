// A session's WebSocket: order, answers matched to calls, refusals, and its end.

import assert from "node:assert/strict";
import { test, type TestContext } from "node:test";
import { RoomLight, RoomLightError, type ClientOptions, type Lights, type StreamOptions } from "roomlight";
import { waiting } from "#waiting";
import { lightMessage, serve, STATE } from "./server.js";
import { plainFrame, vectors } from "./vectors.js";

interface Text {
  type: string;
  [name: string]: unknown;
}
type Received = Buffer | Text;

const isFrame = (message: Received): message is Buffer => Buffer.isBuffer(message);

/** A stream to a server that sends the messages of `reply` for each message it receives. */
async function streamTo(
  context: TestContext,
  reply: (message: Received) => (object | Uint8Array)[],
  options: StreamOptions = {},
  client: ClientOptions = {},
) {
  const received: Received[] = [];
  const server = await serve(
    context,
    () => ({ body: STATE }),
    (socket) =>
      socket.on("message", (data: Buffer, binary) => {
        const message = binary ? data : (JSON.parse(data.toString()) as Received);
        received.push(message);
        reply(message).forEach((one) => socket.send(one instanceof Uint8Array ? one : JSON.stringify(one)));
      }),
  );
  const session = await new RoomLight(server.url, { reconnect: false, ...client }).open();
  const stream = await session.stream(options);
  context.after(() => stream.close());
  return { server, session, received, stream };
}

const indexOf = (message: Buffer) =>
  (JSON.parse(message.subarray(8, 8 + message.readUInt32LE(4)).toString()) as { index: number }).index;
const frameEvent = (index: number) => ({
  type: "frame",
  index,
  status: "processed",
  replay: false,
  stage_ms: {},
  coverage: {},
});
const refused = { type: "about:blank", title: "Refused", status: 409, detail: "older" };
const isRefusal = (error: unknown) => error instanceof RoomLightError && error.status === 409;

test("frames are sent in order, and each push gets its own result", async (context) => {
  const held: object[] = [];
  const reply = (message: Received) => {
    held.unshift(frameEvent(indexOf(message as Buffer)));
    return held.length === 3 ? held : [];
  };
  const { stream, received, server } = await streamTo(context, reply, {}, { token: "secret" });
  const { frame, bytes } = vectors()[0]!;
  const slow = { ...frame.colour, data: new Blob([frame.colour.data as Uint8Array<ArrayBuffer>]) };
  const results = await Promise.all([
    stream.push({ ...frame, colour: slow }),
    stream.push(plainFrame()),
    stream.push(plainFrame()),
  ]);
  assert.deepEqual(
    results.map(({ index }) => index),
    [7, 8, 9],
  );
  assert.deepEqual(
    received.map((message) => indexOf(message as Buffer)),
    [7, 8, 9],
  );
  assert.deepEqual(received[0], bytes);
  assert.deepEqual(server.protocols, [["roomlight.v1", "bearer.secret"]]);
  assert.equal(stream.bufferedAmount, 0);
});

test("light is requested and received", async (context) => {
  const results = (forms: object[]) => [{ position: [0, 0, 0], name: "table", coverage: 1, etag: "e", forms }];
  const binary = { format: "cube", media_type: "m", bytes: 2 };
  const updates: Lights[] = [];
  const probes: object[] = [];
  const { stream, received } = await streamTo(
    context,
    (message) => {
      if (isFrame(message)) {
        return [];
      }
      const values = { format: "sh", media_type: "j", values: { request: message["request"] } };
      const answers: Record<string, (object | Uint8Array)[]> = {
        light: [{ type: "light", request: message["request"], frame: 1, results: results([values]) }],
        subscribe: [lightMessage({ type: "lighting", frame: 2, results: results([binary]) }, [Uint8Array.of(5, 6)])],
        track: [{ type: "probes", probes: { [message["name"] as string]: message["position"] } }],
        untrack: [{ type: "probes", probes: {} }],
      };
      return answers[message.type]!;
    },
    { onLighting: (update) => updates.push(update), onProbes: (all) => probes.push(all) },
  );
  stream.track("table", Float32Array.of(1, 2, 3));
  stream.subscribe([{ format: "cube" }]);
  stream.untrack("table");
  const request = { probes: [{ name: "table" }], forms: [{ format: "sh" }] } as const;
  const [first, second] = await Promise.all([stream.light(request), stream.light(request)]);
  assert.deepEqual(
    [first, second].map((light) => light.results[0]!.forms[0]!.values),
    [{ request: "r1" }, { request: "r2" }],
  );
  assert.deepEqual(updates[0]!.results[0]!.forms, [{ format: "cube", media_type: "m", data: Uint8Array.of(5, 6) }]);
  assert.deepEqual(probes, [{ table: [1, 2, 3] }, {}]);
  assert.deepEqual(received[0], { type: "track", name: "table", position: [1, 2, 3] });
});

test("a refusal rejects its call, and the connection stays open", async (context) => {
  const problems: RoomLightError[] = [];
  const { stream } = await streamTo(
    context,
    (message) => {
      if (isFrame(message)) {
        const index = indexOf(message);
        return index === 0 ? [{ type: "problem", problem: refused, index }] : [frameEvent(index)];
      }
      return [
        { type: "problem", problem: refused, ...(message.type === "light" ? { request: message["request"] } : {}) },
      ];
    },
    { onProblem: (error) => problems.push(error) },
  );
  await assert.rejects(stream.push(plainFrame()), isRefusal);
  assert.throws(() => stream.track("no such", [0, 0, 0]), /1 to 64 letters.*"no such"/);
  stream.track("many", [0, 0, 0]);
  await assert.rejects(stream.light({ probes: [{ name: "gone" }], forms: [{ format: "sh" }] }), isRefusal);
  assert.equal((await stream.push(plainFrame())).index, 1);
  assert.equal(problems.length, 3);
});

test("malformed messages are reported, invalid frames are not sent", async (context) => {
  const problems: string[] = [];
  const { stream } = await streamTo(
    context,
    (message) => [Uint8Array.of(1, 2), frameEvent(indexOf(message as Buffer))],
    {
      onProblem: (error) => problems.push(error.message),
    },
  );
  await assert.rejects(stream.push({ ...plainFrame(), camera_to_world: [1] }), RangeError);
  assert.equal((await stream.push(plainFrame())).index, 1);
  assert.deepEqual(problems, ["malformed message from the server"]);
});

test("a call without an answer times out", async (context) => {
  context.mock.method(waiting, "delay", async () => undefined);
  const { stream } = await streamTo(context, () => [], {}, { timeout_s: 0.1, reconnect: {} });
  await assert.rejects(stream.light({ probes: [{ name: "table" }], forms: [] }), /light r1: no answer in 0\.1 s/);
  const twice = stream.push({ ...plainFrame(), index: 4 });
  await Promise.all([
    assert.rejects(twice, /sent again/),
    assert.rejects(stream.push({ ...plainFrame(), index: 4 }), /the connection ended 3 times/),
  ]);
});

for (const [messages_s, sent_s, lost_s] of [[0, 27, 57], [75, 0, 105], [180, 0, 120]] as const) {
  test(`a call whose bytes leave in ${sent_s} s waits ${lost_s} s while messages arrive for ${messages_s} s`, async (context) => {
    let later_s = 0;
    class SlowSocket extends WebSocket {
      override get bufferedAmount(): number {
        return Math.max(sent_s - later_s, 0);
      }
    }
    const reply = (message: Received) => (isFrame(message) ? [frameEvent(indexOf(message))] : []);
    const { stream } = await streamTo(context, reply, {}, { WebSocket: SlowSocket });
    context.mock.timers.enable({ apis: ["setTimeout"] });
    const asked = stream.light({ probes: [{ name: "table" }], forms: [] });
    while (stream.status.state === "open") {
      later_s += 3;
      if (later_s <= messages_s && later_s % 15 === 0) {
        await stream.push(plainFrame());
      }
      context.mock.timers.tick(3000);
    }
    await assert.rejects(asked, /light r1: no answer in 30 s/);
    assert.equal(later_s, lost_s);
  });
}

test("a closed connection rejects all pending calls", async (context) => {
  const closed: RoomLightError[] = [];
  let closeSocket = (): void => undefined;
  const reply = () => {
    closeSocket();
    return [];
  };
  const { stream, server } = await streamTo(context, reply, { onClose: (error) => closed.push(error) });
  closeSocket = () => server.sockets[0]!.close(4404, "session-not-found");
  const pushed = stream.push(plainFrame());
  await assert.rejects(pushed, /4404: session-not-found/);
  await assert.rejects(stream.push(plainFrame()), /4404/);
  assert.throws(() => stream.untrack("table"), /4404/);
  assert.equal(closed.length, 1);
});

test("a stream closes by a call or a signal, or fails to open", async (context) => {
  const { stream, session } = await streamTo(context, () => []);
  const pushed = stream.push(plainFrame());
  stream.close();
  await assert.rejects(pushed, /closed/);
  const aborted = new AbortController();
  const second = await session.stream({ signal: aborted.signal });
  aborted.abort();
  await assert.rejects(second.push(plainFrame()));
  await assert.rejects(session.stream({ signal: aborted.signal }));
  assert.equal(second.status.state, "closed");
  for (const token of ["a-token", "no/subprotocol="]) {
    const silent = await new RoomLight("http://127.0.0.1:1", {
      token,
      fetch: async () => new Response(JSON.stringify(STATE)),
    }).open();
    await assert.rejects(silent.stream(), RoomLightError);
  }
});
