// A stream and HTTP pushes whose server ends under them: what is sent again, what is not, and what the app is told.

import assert from "node:assert/strict";
import { test, type TestContext } from "node:test";
import { RoomLight, RoomLightError, type ClientOptions, type StreamStatus } from "roomlight";
import { waiting } from "#waiting";
import { problem, serve, STATE, type ReceivedRequest, type ScriptedResponse } from "./server.js";
import { plainFrame } from "./vectors.js";

type Text = { type: string; index?: number; [name: string]: unknown };

const indexOf = (message: Buffer) =>
  (JSON.parse(message.subarray(8, 8 + message.readUInt32LE(4)).toString()) as { index: number }).index;
const result = (index: number, more: object = {}) => ({ index, status: "processed", replay: false, stage_ms: {}, coverage: {}, ...more });
const problemBody = (kind: string, status: number) => ({ type: `urn:roomlight:problem:${kind}`, title: "No", status, detail: "no" });
const missing: ScriptedResponse = { ...problem(404), body: JSON.stringify(problemBody("session-not-found", 404)) };

/** A server with one session that a test can lose, restart and make silent. */
class Room {
  exists = true;
  lastIndex: number | null = null;
  probes: Record<string, readonly number[]> = {};
  durable: number | null = null;
  silent = false;
  readonly log: string[] = [];
  readonly waits_s: number[] = [];
  readonly statuses: StreamStatus[] = [];
  answer: (index: number) => Text | null = (index) => ({ type: "frame", ...result(index, { durable_index: this.durable }) });
  http: (request: ReceivedRequest) => ScriptedResponse | null = () => null;
  sockets: import("ws").WebSocket[] = [];
  private changed: () => void = () => undefined;

  get state() {
    return { ...STATE, probes: this.probes, frames: { ...STATE.frames, last_index: this.lastIndex } };
  }

  lose() {
    [this.exists, this.lastIndex, this.probes] = [false, null, {}];
  }

  accept(index: number): void {
    this.lastIndex = Math.max(this.lastIndex ?? -1, index);
  }

  respond = (request: ReceivedRequest): ScriptedResponse => {
    const path = request.path.replace("/v1/sessions/room", "");
    this.log.push(`${request.method} ${path}`.trim());
    const scripted = this.http(request);
    if (scripted) {
      return scripted;
    }
    if (request.method === "PUT" && path === "") {
      const status = this.exists ? 200 : 201;
      this.exists = true;
      return { status, body: this.state };
    }
    if (!this.exists) {
      return missing;
    }
    if (path.startsWith("/frames/")) {
      this.accept(indexOf(request.body));
      return { body: result(indexOf(request.body), { durable_index: this.durable }) };
    }
    return { body: this.state };
  };

  connected = (socket: import("ws").WebSocket) => {
    this.sockets.push(socket);
    if (!this.exists) {
      socket.close(4404, "session-not-found");
    }
    socket.on("message", (data: Buffer, binary) => {
      const message: Text = binary ? { type: "frame", index: indexOf(data) } : (JSON.parse(data.toString()) as Text);
      this.log.push([message.type, message.index ?? message["name"] ?? message["request"]].filter((part) => part !== undefined).join(" "));
      this.changed();
      if (this.silent) {
        return;
      }
      if (binary) {
        this.accept(message.index!);
        const answer = this.answer(message.index!);
        return void (answer && socket.send(JSON.stringify(answer)));
      }
      if (message.type === "track" || message.type === "untrack") {
        const { [message["name"] as string]: _, ...others } = this.probes;
        this.probes = message.type === "track" ? { ...others, [message["name"] as string]: message["position"] as number[] } : others;
        socket.send(JSON.stringify({ type: "probes", probes: this.probes }));
      }
    });
  };

  /** Resolves when the log has an entry. */
  async logged(entry: string, count = 1): Promise<void> {
    while (this.log.filter((one) => one === entry).length < count) {
      await new Promise<void>((resolve) => (this.changed = resolve));
    }
  }

  async session(context: TestContext, client: ClientOptions = {}) {
    const server = await serve(context, this.respond, this.connected);
    context.mock.method(waiting, "random", () => 1);
    context.mock.method(waiting, "delay", async (seconds: number) => void this.waits_s.push(seconds));
    const options = { retries: 0, reconnect: { attempts: 5 }, ...client };
    return new RoomLight(server.url, options).open({ id: "room", height: 64 });
  }

  async stream(context: TestContext, client: ClientOptions = {}) {
    const session = await this.session(context, client);
    let opened: () => void = () => undefined;
    const stream = await session.stream({
      onStatus: (status) => {
        this.statuses.push(status);
        if (status.state === "open" || status.state === "closed") {
          opened();
        }
      },
    });
    context.after(() => stream.close());
    const settled = () => new Promise<void>((resolve) => (opened = resolve));
    return { session, stream, settled };
  }

  get states() {
    return this.statuses.map(({ state }) => state);
  }
}

test("a lost connection is resumed and nothing is sent twice", async (context) => {
  const room = new Room();
  const { stream, settled } = await room.stream(context);
  stream.track("table", [1, 2, 3]);
  stream.subscribe([{ format: "sh" }]);
  assert.equal((await stream.push(plainFrame())).status, "processed");
  room.answer = () => {
    room.sockets.at(-1)!.terminate(); // frame 1 has arrived, its answer is lost
    room.answer = (next) => ({ type: "frame", ...result(next) });
    return null;
  };
  const back = settled();
  const lost = await stream.push(plainFrame());
  await back;
  assert.deepEqual([lost.index, lost.status, lost.replay], [1, "queued", true]);
  assert.equal((await stream.push(plainFrame())).index, 2);
  assert.deepEqual(
    room.log.filter((entry) => entry.startsWith("frame")),
    ["frame 0", "frame 1", "frame 2"],
  );
  assert.equal(room.log.filter((entry) => entry === "subscribe").length, 2);
  assert.equal(room.log.filter((entry) => entry === "track table").length, 1); // the session still has it
  assert.deepEqual(room.states, ["connecting", "open", "reconnecting", "open"]);
  assert.deepEqual([room.statuses[2]!.attempt, room.statuses[3]!.reopened], [1, false]);
});

const ALL = ["track moved", "track removed"];
for (const [kind, left, restored] of [
  ["opened", ["moved", "mine", "lamp", "shade"], ["untrack mine", ...ALL]],
  ["joined", ["moved", "mine", "lamp", "shade"], ["untrack mine"]],
  ["joined", [], ALL],
] as const) {
  test(`a session that was ${kind} and has ${left.length} points gets changes that it has not confirmed; others' stay`, async (context) => {
    const room = new Room();
    const { session, stream, settled } = await room.stream(context);
    Object.assign((session as unknown as { memory: object }).memory, kind === "joined" ? { request: null } : {});
    ["moved", "removed", "mine", "lamp"].forEach((name) => stream.track(name, [1, 2, 3]));
    stream.untrack("lamp");
    await session.untrack("shade");
    await stream.push(plainFrame());
    room.silent = true;
    stream.untrack("mine");
    await room.logged("untrack mine");
    room.silent = false;
    room.probes = Object.fromEntries(left.map((name) => [name, [4, 5, 6]]));
    room.log.length = 0;
    context.mock.method(waiting, "delay", async () => stream.track("new", [1, 2, 3]));
    room.silent = true;
    room.sockets.at(-1)!.terminate();
    await room.logged("track new");
    room.silent = false;
    context.mock.method(waiting, "delay", async () => undefined);
    const back = settled();
    room.sockets.at(-1)!.terminate(); // before the server took them
    await back;
    await stream.push(plainFrame());
    const sent = ["GET", ...restored, "track new"];
    assert.deepEqual(room.log, [...sent, ...sent, "frame 1"]);
  });
}

test("a joined session gets changes over HTTP once", async (context) => {
  const room = new Room();
  const { session, stream } = await room.stream(context);
  const { memory, requests } = session as unknown as { memory: object; requests: { restore(): Promise<void> } };
  Object.assign(memory, { request: null });
  room.silent = true;
  room.probes = { shade: [4, 5, 6] };
  stream.track("lamp", [1, 2, 3]);
  stream.untrack("shade");
  await room.logged("untrack shade");
  room.log.length = 0;
  await requests.restore();
  await requests.restore(); // others have changed both again
  assert.deepEqual(room.log, ["GET", "DELETE /probes/shade", "PUT /probes/lamp", "GET"]);
});

test("a session that the server lost is opened again", async (context) => {
  const room = new Room();
  const { stream, settled } = await room.stream(context);
  stream.track("table", [1, 2, 3]);
  await stream.push(plainFrame());
  room.silent = true;
  const unanswered = stream.push(plainFrame());
  await room.logged("frame 1");
  room.lose();
  room.silent = false;
  room.log.length = 0;
  const back = settled();
  room.sockets.at(-1)!.terminate();
  await back;
  assert.equal((await unanswered).status, "processed");
  assert.deepEqual(room.log, ["GET", "PUT", "track table", "frame 0", "frame 1"]);
  assert.equal(room.statuses.at(-1)!.reopened, true);
});

test("frames that the server lost are sent one by one", async (context) => {
  const room = new Room();
  const { stream, settled } = await room.stream(context);
  for (let index = 0; index < 4; index++) {
    room.durable = index === 1 ? 1 : null;
    await stream.push(plainFrame());
  }
  room.lastIndex = 2; // restored from its disk: frame 3 is lost
  room.answer = (index) => (index === 3 ? null : { type: "frame", ...result(index) });
  room.log.length = 0;
  const back = settled();
  room.sockets.at(-1)!.terminate();
  await back;
  const next = stream.push(plainFrame());
  await room.logged("frame 3");
  assert.deepEqual(room.log, ["GET", "frame 3"]); // frame 4 waits for its answer
  room.sockets.at(-1)!.send(JSON.stringify({ type: "frame", ...result(3) }));
  assert.equal((await next).index, 4);
  assert.equal(room.statuses.at(-1)!.incomplete, false);
});

test("frames pushed without a connection wait in a bounded buffer", async (context) => {
  const room = new Room();
  let release: () => void = () => undefined;
  const { stream, settled } = await room.stream(context, { buffer: { frames: 2 }, reconnect: {} });
  context.mock.method(waiting, "delay", () => new Promise<void>((resolve) => (release = resolve)));
  const reconnecting = settled();
  room.sockets.at(-1)!.terminate();
  while (stream.status.state === "open") {
    await new Promise((resolve) => setImmediate(resolve));
  }
  const pushed = [stream.push(plainFrame()), stream.push(plainFrame()), stream.push(plainFrame())];
  await assert.rejects(pushed[0]!, /frame 0 was dropped: the buffer/);
  assert.ok(stream.bufferedAmount > 0);
  release();
  await reconnecting;
  const results = await Promise.all(pushed.slice(1));
  assert.deepEqual(
    results.map(({ index }) => index),
    [1, 2],
  );
  assert.equal(stream.bufferedAmount, 0);
});

test("delays double up to their bound, and attempts end", async (context) => {
  const room = new Room();
  const reconnect = { attempts: 4, firstDelay_s: 1, maxDelay_s: 3 };
  const { stream, settled } = await room.stream(context, { reconnect });
  room.http = () => ({ fails: "closes" });
  const closed = settled();
  room.sockets.at(-1)!.terminate();
  await closed;
  assert.deepEqual(room.waits_s, [1, 2, 3, 3]);
  assert.equal(stream.status.state, "closed");
  await assert.rejects(stream.push(plainFrame()), RoomLightError);
});

test("a refusal that lasts ends the stream at once", async (context) => {
  const room = new Room();
  const { stream, settled } = await room.stream(context);
  room.http = () => ({ ...problem(401), body: JSON.stringify(problemBody("unauthorized", 401)) });
  const closed = settled();
  room.sockets.at(-1)!.terminate();
  await closed;
  assert.deepEqual([stream.status.state, stream.status.error!.status, room.waits_s.length], ["closed", 401, 1]);
});

test("a stream of a missing session does not open", async (context) => {
  const room = new Room();
  const session = await room.session(context);
  room.lose();
  await assert.rejects(session.stream(), (error) => error instanceof RoomLightError && error.status === 404);
  assert.equal(room.sockets.length, 0);
});

test("a joined or deleted session is not opened again", async (context) => {
  const room = new Room();
  const { session, stream, settled } = await room.stream(context);
  const joined = await new RoomLight(String((session as unknown as { http: { base: URL } }).http.base)).join("room");
  const viewer = await joined.stream();
  room.http = ({ method }) => (method === "DELETE" ? { status: 204 } : null);
  await session.delete();
  const closed = settled();
  room.lose();
  room.sockets.forEach((socket) => socket.close(4410, "session-closed"));
  await closed;
  while (viewer.status.state !== "closed") {
    await new Promise((resolve) => setImmediate(resolve));
  }
  assert.equal(stream.status.state, "closed");
  assert.equal(room.log.filter((entry) => entry === "PUT").length, 1);
});

test("a joined session that was only saved goes on", async (context) => {
  const room = new Room();
  const { session, stream, settled } = await room.stream(context);
  Object.assign((session as unknown as { memory: object }).memory, { request: null });
  const opened = settled();
  room.sockets[0]!.close(4410, "session-closed");
  await opened;
  room.answer = (index) => {
    room.lastIndex = null;
    const saved = { type: "problem", index, problem: problemBody("session-closed", 410) };
    return room.sockets.length === 2 ? saved : { type: "frame", ...result(index) };
  };
  assert.equal((await stream.push(plainFrame())).status, "processed");
});

test("a frame that ends each connection is given up", async (context) => {
  const room = new Room();
  const { stream } = await room.stream(context);
  room.answer = () => {
    room.lastIndex = null;
    room.sockets.at(-1)!.terminate();
    return null;
  };
  await assert.rejects(stream.push(plainFrame()), /the connection ended 3 times/);
  assert.equal(room.log.filter((entry) => entry === "frame 0").length, 3);
});

test("a frame without an answer in time is kept until the server says whether it arrived", async (context) => {
  const room = new Room();
  const { stream } = await room.stream(context, { timeout_s: 0.2 });
  room.answer = () => null;
  assert.equal((await stream.push(plainFrame())).status, "queued");
  assert.equal(room.log.filter((entry) => entry === "frame 0").length, 1);
});

test("a frame that a stopping server refuses waits for the next", async (context) => {
  const room = new Room();
  const { stream } = await room.stream(context);
  room.answer = (index) => {
    room.lastIndex = null;
    const refusals = room.log.filter((entry) => entry === "frame 0").length;
    return refusals > 4 ? { type: "frame", ...result(index) } : { type: "problem", index, problem: problemBody("stopping", 503) };
  };
  assert.equal((await stream.push(plainFrame())).status, "processed");
  assert.deepEqual(room.waits_s, [0.25, 0.5, 1, 2]);
});

test("a saved state that cannot be used is deleted", async (context) => {
  const room = new Room();
  const { settled } = await room.stream(context);
  room.http = ({ method }) => {
    if (method === "DELETE") {
      room.http = () => null;
      room.lose();
      return { status: 204 };
    }
    return { ...problem(409), body: JSON.stringify(problemBody("state-refused", 409)) };
  };
  const back = settled();
  room.sockets.at(-1)!.terminate();
  await back;
  assert.deepEqual(room.log.slice(-3), ["GET", "DELETE", "PUT"]);
});

test("HTTP pushes survive a server that lost the session", async (context) => {
  const room = new Room();
  const session = await room.session(context);
  await session.track("table", [1, 2, 3]);
  const stream = await session.stream();
  stream.track("my-lamp", [4, 5, 6]); // the server refuses it
  stream.close();
  await session.push(plainFrame());
  room.lose();
  room.http = ({ path }) => (path.endsWith("/probes/my-lamp") ? problem(422) : null);
  room.log.length = 0;
  assert.equal((await session.push(plainFrame())).index, 1);
  const points = ["PUT /probes/table", "PUT /probes/my-lamp"];
  assert.deepEqual(room.log, ["PUT /frames/1", "GET", "PUT", ...points, "PUT /frames/0", "PUT /frames/1"]);
  room.lose();
  assert.equal((await session.state()).id, "room"); // opened again for any call
});

test("a call that is aborted leaves the recovery to the others", async (context) => {
  const room = new Room();
  const session = await room.session(context);
  await session.push(plainFrame());
  await session.push(plainFrame());
  const aborted = new AbortController();
  let during: Promise<unknown> = Promise.resolve();
  room.lose();
  room.http = ({ path }) => {
    if (path.endsWith("/frames/0")) {
      aborted.abort();
      during = session.state();
    }
    return null;
  };
  room.log.length = 0;
  await assert.rejects(session.state({ signal: aborted.signal }), { name: "AbortError" });
  await during;
  assert.deepEqual(room.log, ["GET", "GET", "PUT", "PUT /frames/0", "PUT /frames/1", "GET"]);
});

test("HTTP pushes wait for a server that is away", async (context) => {
  const room = new Room();
  const session = await room.session(context);
  await session.push(plainFrame());
  let away = 3;
  room.http = () => (away-- > 0 ? { fails: "closes" } : ((room.http = () => null), (room.lastIndex = null), null));
  room.log.length = 0;
  assert.equal((await session.push(plainFrame())).index, 1);
  assert.deepEqual(room.log.slice(-3), ["GET", "PUT /frames/0", "PUT /frames/1"]);
  assert.deepEqual(room.waits_s, [0.25, 0.5, 1]);
  room.http = () => ({ fails: "closes" });
  await assert.rejects(session.push(plainFrame()), RoomLightError);
  assert.equal(room.waits_s.length, 3 + 5);
});
