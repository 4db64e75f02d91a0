// Sessions over HTTP: requests, responses, retries and errors.

import assert from "node:assert/strict";
import { test } from "node:test";
import { RoomLight, RoomLightError } from "roomlight";
import { lightMessage, problem, serve, STATE, type ReceivedRequest, type ScriptedResponse } from "./server.js";
import { plainFrame, vectors } from "./vectors.js";

const PROCESSED = { index: 7, status: "processed", replay: false, stage_ms: {}, coverage: {} };

test("the requests of a session from open to delete", async (context) => {
  const server = await serve(context, ({ method, path }: ReceivedRequest): ScriptedResponse => {
    if (method === "DELETE") {
      return { status: 204 };
    }
    return path.includes("/frames/") ? { body: PROCESSED } : { body: STATE };
  });
  const session = await new RoomLight(`${server.url}/below`, { token: "a-token", retries: undefined }).open({
    id: undefined,
    model: "classical",
    height: 64,
    reference_exposure: undefined,
    signal: undefined,
  });
  assert.match(session.id, /^[0-9a-f]{32}$/);
  const { frame, bytes } = vectors()[0]!;
  assert.deepEqual(await session.push(frame), PROCESSED);
  await session.push({ ...plainFrame(), timestamp_s: undefined }, { wait: false });
  await session.track("table", Float32Array.of(1, -2, 0.5));
  await session.untrack("table");
  await assert.rejects(session.untrack("a/b"), RoomLightError);
  assert.equal((await session.state()).status, "open");
  await session.delete();
  const base = `/below/v1/sessions/${session.id}`;
  assert.deepEqual(
    server.requests.map(({ method, path }) => `${method} ${path.replace(base, "")}`),
    ["PUT ", "PUT /frames/7", "PUT /frames/8", "PUT /probes/table", "DELETE /probes/table", "GET ", "DELETE "],
  );
  const [opened, first, second, tracked] = server.requests as [
    ReceivedRequest,
    ReceivedRequest,
    ReceivedRequest,
    ReceivedRequest,
  ];
  assert.deepEqual(JSON.parse(opened.body.toString()), { model: "classical", height: 64 });
  assert.deepEqual(first.body, bytes);
  assert.equal(first.headers["content-type"], "application/vnd.roomlight.frame");
  assert.equal(first.headers.prefer, undefined);
  assert.equal(second.headers.prefer, "respond-async");
  assert.deepEqual(JSON.parse(tracked.body.toString()), { position: [1, -2, 0.5] });
  assert.ok(server.requests.every(({ headers }) => headers.authorization === "Bearer a-token"));
});

test("objects and composites", async (context) => {
  const info = { id: "0".repeat(64), triangles: 4, size_m: [1, 1, 1], bytes: 100 };
  const poses = { ball: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -2, 1] };
  const server = await serve(context, ({ method, path }: ReceivedRequest): ScriptedResponse => {
    if (method === "DELETE") {
      return { status: 204 };
    }
    if (path.endsWith("/composite")) {
      const headers = { "roomlight-frame": "7", "roomlight-poses": JSON.stringify(poses), "content-type": "image/png" };
      return { body: Uint8Array.of(1, 2, 3), headers };
    }
    return { body: method === "GET" ? { objects: [info], bytes: 100, limit_bytes: 1000 } : path.includes("objects") ? info : STATE };
  });
  const roomlight = new RoomLight(server.url);
  assert.deepEqual(await roomlight.upload(Uint8Array.of(9, 8) as Uint8Array, { kind: "obj", sessionId: "room" }), info);
  assert.deepEqual((await roomlight.objects({ sessionId: "room" })).objects, [info]);
  const session = await roomlight.open({ id: "room" });
  const request = { objects: [{ shape: "sphere", size_m: 0.2, pixel: [3, 4] }], quality: "good" } as const;
  const timers = context.mock.method(globalThis, "setTimeout");
  const made = await session.composite(request);
  assert.ok(timers.mock.calls.some((call) => call.arguments[1] === 130_000));
  assert.deepEqual([made.frame, made.poses, made.data.type], [7, poses, "image/png"]);
  assert.deepEqual(new Uint8Array(await made.data.arrayBuffer()), Uint8Array.of(1, 2, 3));
  await roomlight.deleteObject(info.id, { sessionId: "room" });
  assert.ok(server.requests.every(({ path, headers }) => path.includes("sessions") || headers["x-session-id"] === "room"));
  assert.deepEqual(
    server.requests.map(({ method, path }) => `${method} ${path}`),
    [
      "POST /v1/objects?kind=obj",
      "GET /v1/objects",
      "PUT /v1/sessions/room",
      "POST /v1/sessions/room/composite",
      `DELETE /v1/objects/${info.id}`,
    ],
  );
  assert.deepEqual(server.requests[0]!.body, Buffer.from([9, 8]));
  assert.deepEqual(JSON.parse(server.requests[3]!.body.toString()), request);
});

test("a composite or object that a proxy or server gave up waiting for is not sent again", async (context) => {
  const server = await serve(context, ({ method }) => (method === "POST" ? problem(server.requests.length > 2 ? 408 : 504, "0") : { body: STATE }));
  const roomlight = new RoomLight(server.url);
  const session = await roomlight.open();
  await assert.rejects(session.composite({ objects: [{ shape: "sphere", size_m: 0.2, pixel: [3, 4] }] }), { status: 504 });
  const timers = context.mock.method(globalThis, "setTimeout");
  await assert.rejects(roomlight.upload(new Uint8Array(2 ** 16)), { status: 408 });
  assert.equal(server.requests.length, 3);
  assert.ok(timers.mock.calls.some((call) => call.arguments[1] === 34_000)); // 4 s at the slowest that a server accepts
});

test("binary and JSON light messages give the same light, after a proxy that did not wait for it", async (context) => {
  const data = Uint8Array.of(1, 2, 3, 255);
  const result = (form: object) => ({
    frame: 4,
    results: [
      {
        position: [0, 1, 2],
        coverage: 0.5,
        etag: "e",
        forms: [{ format: "sh", media_type: "j", values: { a: 1 } }, form],
      },
    ],
  });
  const part = { format: "exr", media_type: "image/x-exr" };
  let binary = true;
  const server = await serve(context, ({ path }) => {
    if (!path.endsWith("/probes")) {
      return { body: STATE };
    }
    if (server.requests.length === 2) {
      return problem(504, "0");
    }
    return binary
      ? {
          headers: { "content-type": "application/vnd.roomlight.light" },
          body: lightMessage(result({ ...part, bytes: 4 }), [data]),
        }
      : { body: result({ ...part, data: Buffer.from(data).toString("base64") }) };
  });
  const session = await new RoomLight(server.url).open();
  const forms = [{ format: "sh" }, { format: "exr" }] as const;
  const first = await session.lightAt([0, 1, 2], forms);
  binary = false;
  assert.deepEqual(await session.lightAt("table", forms), first);
  assert.deepEqual(first.forms, [
    { format: "sh", media_type: "j", values: { a: 1 } },
    { ...part, data },
  ]);
  assert.deepEqual(JSON.parse(server.requests[2]!.body.toString()), { probes: [{ position: [0, 1, 2] }], forms });
  assert.deepEqual(JSON.parse(server.requests[3]!.body.toString()).probes, [{ name: "table" }]);
  assert.ok(server.requests[1]!.headers.accept!.startsWith("application/vnd.roomlight.light"));
});

test("a form with an unchanged ETag is not sent again", async (context) => {
  const server = await serve(context, ({ headers, path }) => {
    if (!path.includes("probe")) {
      return { body: STATE };
    }
    const etag = { etag: '"a"', "roomlight-coverage": "0.25", "roomlight-frame": "3" };
    return headers["if-none-match"] === '"a"'
      ? { status: 304, headers: etag }
      : {
          headers: { ...etag, "content-type": path.includes("sh") ? "application/json" : "image/png" },
          body: '{"a":1}',
        };
  });
  const session = await new RoomLight(server.url).open({ id: "s" });
  const found = await session.probe([1, 2, -3], { format: "sh", basis: "threejs", size: null });
  assert.deepEqual(found, {
    form: { format: "sh", media_type: "application/json", values: { a: 1 } },
    etag: '"a"',
    coverage: 0.25,
    frame: 3,
  });
  assert.equal(await session.probe([1, 2, -3], { format: "sh" }, { etag: found!.etag }), null);
  assert.deepEqual((await session.probe("table", { format: "png" }))!.form.data, new TextEncoder().encode('{"a":1}'));
  assert.equal(server.requests[1]!.path, "/v1/sessions/s/probe?x=1&y=2&z=-3&format=sh&basis=threejs");
  assert.equal(server.requests[3]!.path, "/v1/sessions/s/probes/table?format=png");
});

test("temporary failures are retried after Retry-After", async (context) => {
  const responses: ScriptedResponse[] = [
    problem(408, "0"),
    { fails: "closes" },
    problem(503, new Date(0).toUTCString()),
    { body: STATE },
  ];
  const server = await serve(context, () => responses.shift()!);
  await new RoomLight(server.url).open();
  assert.equal(server.requests.length, 4);
  const timers = context.mock.method(globalThis, "setTimeout");
  responses.push(problem(503, "0.2"), { body: STATE });
  await new RoomLight(server.url, { timeout_s: 17 }).open();
  const delays_ms = timers.mock.calls.map((call) => call.arguments[1]);
  assert.deepEqual(
    delays_ms.filter((delay_ms) => delay_ms === 17000 || delay_ms === 200),
    [17000, 200, 17000],
  );
});

test("permanent refusals fail at once with the server's problem", async (context) => {
  const responses = [
    problem(409, "0"),
    problem(422),
    problem(503, "60"),
    problem(429, "0"),
    problem(429, "0"),
    { status: 500, body: "<html>" },
  ];
  const server = await serve(context, () => responses.shift()!);
  const open = (retries = 3) =>
    new RoomLight(server.url, { retries }).open().then(
      () => assert.fail("opened"),
      (error: RoomLightError) => error,
    );
  const conflict = await open();
  assert.ok(conflict instanceof RoomLightError);
  assert.deepEqual([conflict.status, conflict.message], [409, "Refused: no; depth.bytes: at most 2; got 7"]);
  assert.deepEqual([conflict.kind, conflict.field, conflict.rule], ["session-conflict", "depth.bytes", "at most 2"]);
  assert.equal((await open()).status, 422);
  assert.equal((await open()).status, 503); // a minute is longer than the client waits
  assert.equal((await open(1)).status, 429);
  assert.deepEqual(await open().then((error) => [error.status, error.problem]), [500, null]);
  assert.equal(server.requests.length, 6);
  responses.push({ body: "<html>" });
  const portal = await open();
  assert.ok(portal instanceof RoomLightError && portal.message.includes("<html>"));
});

test("a timeout and an unreachable server are errors", async (context) => {
  const server = await serve(context, () => ({ fails: "hangs" }));
  const timeout = new RoomLight(server.url, { timeout_s: 0.5, retries: 1 }).open();
  await assert.rejects(
    timeout,
    (error) => error instanceof RoomLightError && error.status === 0 && /0\.5 s/.test(error.message),
  );
  assert.equal(server.requests.length, 2);
  const upload = new RoomLight(server.url, { timeout_s: 1 }).upload(Uint8Array.of(1));
  await assert.rejects(upload, /no answer in 1 s/);
  assert.equal(server.requests.length, 3); // not repeated
  const unreachable = new RoomLight("http://127.0.0.1:1", { retries: 0 }).open();
  await assert.rejects(
    unreachable,
    (error) =>
      error instanceof RoomLightError &&
      error.status === 0 &&
      error.cause !== undefined &&
      /no connection \(.+\)$/.test(error.message),
  );
});

test("an abort ends a request and the delay before a retry", async (context) => {
  let aborted = new AbortController();
  const abort = () => aborted.abort(new Error("no longer needed"));
  const server = await serve(context, ({ path }) => {
    if (path.endsWith("delayed")) {
      return problem(503, "5");
    }
    abort();
    return { fails: "hangs" };
  });
  const { setTimeout } = globalThis;
  const abortInDelay = (callback: () => void, delay_ms?: number) => {
    if (delay_ms === 5000) {
      queueMicrotask(abort);
    }
    return setTimeout(callback, delay_ms);
  };
  context.mock.method(globalThis, "setTimeout", abortInDelay as typeof setTimeout);
  for (const id of ["hanging", "delayed"]) {
    aborted = new AbortController();
    const { signal } = aborted;
    await assert.rejects(new RoomLight(server.url).open({ id, signal }), /no longer needed/);
    await assert.rejects(new RoomLight(server.url).open({ signal }), /no longer needed/);
  }
  assert.equal(server.requests.length, 2);
});

test("what is missing counts as deleted", async (context) => {
  const responses: ScriptedResponse[] = [{ body: STATE }, problem(404), { fails: "closes" }, problem(410)];
  const server = await serve(context, () => responses.shift()!);
  const session = await new RoomLight(server.url).open();
  await session.untrack("table");
  await session.delete();
  assert.equal(server.requests.length, 4);
});

test("frames are sent in the order of the calls, also next to an invalid one", async () => {
  const sent: string[] = [];
  const answer = async (url: string | URL | Request) => {
    sent.push(String(url).split("/").at(-1)!);
    return new Response(JSON.stringify(String(url).includes("/frames/") ? PROCESSED : STATE));
  };
  const session = await new RoomLight("http://light.example", { fetch: answer }).open({ id: "room" });
  const frame = plainFrame();
  let encoded: (image: Blob) => void;
  const slow = session.push({ ...frame, colour: { ...frame.colour, data: new Promise<Blob>((done) => (encoded = done)) } });
  const invalid = session.push({ ...frame, camera_to_world: [] });
  const gone = new AbortController();
  const never = session.push({ ...frame, colour: { ...frame.colour, data: new Promise<Blob>(() => undefined) } }, { signal: gone.signal });
  const next = session.push(frame);
  await new Promise(setImmediate); // nothing has reported the invalid frame as unhandled
  gone.abort();
  await assert.rejects(never, { name: "AbortError" });
  encoded!(new Blob([Uint8Array.of(1)]));
  await Promise.all([slow, assert.rejects(invalid, RangeError), next]);
  assert.deepEqual(sent, ["room", "0", "3"]);
  assert.equal(await (session as unknown as { lastPacked: Promise<unknown> }).lastPacked, undefined); // keeps no frame
});

test("joining a session continues its index and sends no options", async (context) => {
  const frames = { ...STATE.frames, accepted: 8, processed: 8, last_index: 41 };
  const responses: ScriptedResponse[] = [{ body: { ...STATE, frames } }, { body: PROCESSED }, problem(404)];
  const server = await serve(context, () => responses.shift()!);
  const session = await new RoomLight(server.url).join("room");
  assert.deepEqual([session.id, session.model, session.nextIndex], ["room", "classical", 42]);
  await session.push(plainFrame());
  await assert.rejects(
    new RoomLight(server.url).join("gone"),
    (error) => error instanceof RoomLightError && error.status === 404,
  );
  assert.deepEqual(
    server.requests.map(({ method, path }) => `${method} ${path}`),
    ["GET /v1/sessions/room", "PUT /v1/sessions/room/frames/42", "GET /v1/sessions/gone"],
  );
});

test("an address or a token that no request can have is refused with its value", () => {
  assert.throws(() => new RoomLight("https://light.example", { token: "schl\u00fcssel" }), /RoomLightError.*got one with "\u00fc"/);
  for (const url of ["localhost:8090", "ws://light.example", "http://user:word@light.example", "light.example", ""]) {
    assert.throws(
      () => new RoomLight(url),
      (error) => error instanceof RoomLightError && error.message.endsWith(`got ${url}`),
    );
  }
});
