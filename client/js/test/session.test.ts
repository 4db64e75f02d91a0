// Sessions over HTTP: what is sent, what comes back, what is tried again and what ends at once.

import assert from "node:assert/strict";
import { test } from "node:test";
import { RoomLight, RoomLightError } from "roomlight";
import { lightMessage, problem, serve, type Answer, type Asked } from "./server.js";
import { plainFrame, vectors } from "./vectors.js";

const PROCESSED = { index: 7, status: "processed", replay: false, stage_ms: {}, coverage: {} };

test("a session from its opening to its end", async (context) => {
  const server = await serve(context, ({ method, path }: Asked): Answer => {
    if (method === "DELETE") {
      return { status: 204 };
    }
    return path.includes("/frames/") ? { body: PROCESSED } : { body: { id: "x", status: "open" } };
  });
  const session = await new RoomLight(`${server.url}/below`, { token: "a-token" }).open({
    mode: "classical",
    height: 64,
  });
  assert.match(session.id, /^[0-9a-f]{32}$/);
  const { frame, bytes } = vectors()[0]!;
  assert.deepEqual(await session.push(frame), PROCESSED);
  await session.push(plainFrame(), { wait: false });
  await session.track("table", [1, -2, 0.5]);
  await session.untrack("table");
  assert.equal((await session.state()).status, "open");
  await session.delete();
  const base = `/below/v1/sessions/${session.id}`;
  assert.deepEqual(
    server.asked.map(({ method, path }) => `${method} ${path.replace(base, "")}`),
    ["PUT ", "PUT /frames/7", "PUT /frames/8", "PUT /probes/table", "DELETE /probes/table", "GET ", "DELETE "],
  );
  const [opened, first, second, tracked] = server.asked as [Asked, Asked, Asked, Asked];
  assert.deepEqual(JSON.parse(opened.body.toString()), { mode: "classical", height: 64 });
  assert.deepEqual(first.body, bytes);
  assert.equal(first.headers["content-type"], "application/vnd.roomlight.frame");
  assert.equal(first.headers.prefer, undefined);
  assert.equal(second.headers.prefer, "respond-async");
  assert.deepEqual(JSON.parse(tracked.body.toString()), { position: [1, -2, 0.5] });
  assert.ok(server.asked.every(({ headers }) => headers.authorization === "Bearer a-token"));
});

test("light comes as binary or as JSON, and is the same", async (context) => {
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
      return { body: {} };
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
  assert.deepEqual(JSON.parse(server.asked[1]!.body.toString()), { probes: [{ position: [0, 1, 2] }], forms });
  assert.deepEqual(JSON.parse(server.asked[2]!.body.toString()).probes, [{ name: "table" }]);
  assert.ok(server.asked[1]!.headers.accept!.startsWith("application/vnd.roomlight.light"));
});

test("one form is asked for by its ETag", async (context) => {
  const server = await serve(context, ({ headers, path }) => {
    if (!path.includes("probe")) {
      return { body: {} };
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
  assert.equal(server.asked[1]!.path, "/v1/sessions/s/probe?x=1&y=2&z=-3&format=sh&basis=threejs");
  assert.equal(server.asked[3]!.path, "/v1/sessions/s/probes/table?format=png");
});

test("what is full or cut off is tried again, and waits as it is told", async (context) => {
  const answers: Answer[] = [
    problem(429, "0"),
    { fails: "cut" },
    problem(503, new Date(0).toUTCString()),
    { body: {} },
  ];
  const server = await serve(context, () => answers.shift()!);
  await new RoomLight(server.url).open();
  assert.equal(server.asked.length, 4);
  answers.push(problem(503, "0.2"), { body: {} });
  const began = performance.now();
  await new RoomLight(server.url).open();
  assert.ok(performance.now() - began >= 199);
});

test("what will not change is an error at once, in the server's words", async (context) => {
  const answers = [
    problem(409, "0"),
    problem(422),
    problem(503, "60"),
    problem(429, "0"),
    problem(429, "0"),
    { status: 500, body: "<html>" },
  ];
  const server = await serve(context, () => answers.shift()!);
  const open = (retries = 3) =>
    new RoomLight(server.url, { retries }).open().then(
      () => assert.fail("opened"),
      (error: RoomLightError) => error,
    );
  const conflict = await open();
  assert.ok(conflict instanceof RoomLightError);
  assert.deepEqual([conflict.status, conflict.message, conflict.problem!.field], [409, "Refused: no", "depth.bytes"]);
  assert.equal((await open()).status, 422);
  assert.equal((await open()).status, 503); // a minute is more than a phone's frame is worth
  assert.equal((await open(1)).status, 429);
  assert.deepEqual(await open().then((error) => [error.status, error.problem]), [500, null]);
  assert.equal(server.asked.length, 6);
});

test("an answer that does not come, and a server that is not there", async (context) => {
  const server = await serve(context, () => ({ fails: "hangs" }));
  const late = new RoomLight(server.url, { timeout_s: 0.05, retries: 1 }).open();
  await assert.rejects(
    late,
    (error) => error instanceof RoomLightError && error.status === 0 && /0\.05 s/.test(error.message),
  );
  assert.equal(server.asked.length, 2);
  const nobody = new RoomLight("http://127.0.0.1:1", { retries: 0 }).open();
  await assert.rejects(
    nobody,
    (error) => error instanceof RoomLightError && error.status === 0 && error.cause !== undefined,
  );
});

test("an abort ends a request, and the wait before the next one", async (context) => {
  const server = await serve(context, ({ path }) => (path.endsWith("wait") ? problem(503, "5") : { fails: "hangs" }));
  for (const id of ["hang", "wait"]) {
    const aborted = new AbortController();
    const opening = new RoomLight(server.url).open({ id, signal: aborted.signal });
    setTimeout(() => aborted.abort(new Error("no longer wanted")), 50);
    await assert.rejects(opening, /no longer wanted/);
    await assert.rejects(new RoomLight(server.url).open({ signal: aborted.signal }), /no longer wanted/);
  }
  assert.equal(server.asked.length, 2);
});

test("a session that is gone on the second try was deleted by the first", async (context) => {
  const answers: Answer[] = [{ body: {} }, { fails: "cut" }, problem(404), problem(404)];
  const server = await serve(context, () => answers.shift()!);
  const session = await new RoomLight(server.url).open();
  await session.delete();
  await assert.rejects(session.delete(), (error) => error instanceof RoomLightError && error.status === 404);
});
