// A scripted server: each request gets the response that the test gives, and is recorded.

import { createServer, type IncomingHttpHeaders } from "node:http";
import type { AddressInfo } from "node:net";
import type { TestContext } from "node:test";
import type { SessionState } from "roomlight";
import { WebSocketServer, type WebSocket } from "ws";

export interface ReceivedRequest {
  method: string;
  path: string;
  headers: IncomingHttpHeaders;
  body: Buffer;
}

export interface ScriptedResponse {
  status?: number;
  headers?: Record<string, string>;
  body?: Uint8Array | string | object;
  /** No response: the connection is closed, or stays open without data. */
  fails?: "closes" | "hangs";
}

export interface TestServer {
  url: string;
  requests: ReceivedRequest[];
  sockets: WebSocket[];
  protocols: string[][];
}

/** Serve until the test ends. `respond` is called for every request, `connected` for every WebSocket. */
export async function serve(
  context: Pick<TestContext, "after">,
  respond: (request: ReceivedRequest) => ScriptedResponse,
  connected: (socket: WebSocket) => void = () => undefined,
): Promise<TestServer> {
  const result: TestServer = { url: "", requests: [], sockets: [], protocols: [] };
  const server = createServer(async (incoming, response) => {
    const chunks: Buffer[] = [];
    for await (const chunk of incoming) {
      chunks.push(chunk as Buffer);
    }
    const request = {
      method: incoming.method!,
      path: incoming.url!,
      headers: incoming.headers,
      body: Buffer.concat(chunks),
    };
    result.requests.push(request);
    const { status = 200, headers = {}, body = "", fails } = respond(request);
    if (fails) {
      return void (fails === "closes" && incoming.socket.destroy());
    }
    const isJson = typeof body === "object" && !(body instanceof Uint8Array);
    response.writeHead(status, { ...(isJson ? { "content-type": "application/json" } : {}), ...headers });
    response.end(isJson ? JSON.stringify(body) : body);
  });
  const sockets = new WebSocketServer({
    server,
    handleProtocols: (protocols) => {
      result.protocols.push([...protocols]);
      return protocols.has("roomlight.v1") ? "roomlight.v1" : false;
    },
  });
  sockets.on("connection", (socket) => {
    result.sockets.push(socket);
    connected(socket);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  result.url = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
  context.after(() => {
    sockets.clients.forEach((socket) => socket.terminate());
    server.closeAllConnections();
    server.close();
  });
  return result;
}

/** The state of a new session. */
export const STATE = {
  id: "room",
  status: "open",
  model: "classical",
  options: {},
  frames: {
    accepted: 0,
    processed: 0,
    superseded: 0,
    skipped: 0,
    queued: 0,
    gaps: 0,
    replayed: 0,
    refused: 0,
    last_index: null,
  },
  probes: {},
  coverage: {},
  keyframes: 0,
  memory: { bytes: 0, bound_bytes: 1 },
  volume: null,
  idle_expiry_s: 600,
} satisfies SessionState;

/** A refusal with problem details. */
export const problem = (status: number, retryAfter?: string): ScriptedResponse => ({
  status,
  headers: {
    "content-type": "application/problem+json",
    ...(retryAfter === undefined ? {} : { "retry-after": retryAfter }),
  },
  body: JSON.stringify({
    type: "urn:roomlight:problem:session-conflict",
    title: "Refused",
    status,
    detail: "no",
    field: "depth.bytes",
    value: "7",
    rule: "at most 2",
  }),
});

/** A binary light message. */
export function lightMessage(json: object, parts: readonly Uint8Array[]): Buffer {
  const text = Buffer.from(JSON.stringify(json));
  const length = Buffer.alloc(4);
  length.writeUInt32LE(text.length);
  return Buffer.concat([Buffer.from("RLL1"), length, text, ...parts]);
}
