// A server of a test's own: each request gets what the test says, and is kept to be looked at.

import { createServer, type IncomingHttpHeaders } from "node:http";
import type { AddressInfo } from "node:net";
import type { TestContext } from "node:test";
import { WebSocketServer, type WebSocket } from "ws";

export interface Asked {
  method: string;
  path: string;
  headers: IncomingHttpHeaders;
  body: Buffer;
}

export interface Answer {
  status?: number;
  headers?: Record<string, string>;
  body?: Uint8Array | string | object;
  /** No answer: the connection is cut, or left hanging. */
  fails?: "cut" | "hangs";
}

export interface TestServer {
  url: string;
  asked: Asked[];
  sockets: WebSocket[];
  protocols: string[][];
}

/** Serve until the test ends. `answer` is asked for every request, and `connected` for every WebSocket. */
export async function serve(
  context: Pick<TestContext, "after">,
  answer: (asked: Asked) => Answer,
  connected: (socket: WebSocket) => void = () => undefined,
): Promise<TestServer> {
  const found: TestServer = { url: "", asked: [], sockets: [], protocols: [] };
  const server = createServer(async (request, response) => {
    const chunks: Buffer[] = [];
    for await (const chunk of request) {
      chunks.push(chunk as Buffer);
    }
    const asked = {
      method: request.method!,
      path: request.url!,
      headers: request.headers,
      body: Buffer.concat(chunks),
    };
    found.asked.push(asked);
    const { status = 200, headers = {}, body = "", fails } = answer(asked);
    if (fails) {
      return void (fails === "cut" && request.socket.destroy());
    }
    const isJson = typeof body === "object" && !(body instanceof Uint8Array);
    response.writeHead(status, { ...(isJson ? { "content-type": "application/json" } : {}), ...headers });
    response.end(isJson ? JSON.stringify(body) : body);
  });
  const sockets = new WebSocketServer({
    server,
    handleProtocols: (protocols) => {
      found.protocols.push([...protocols]);
      return protocols.has("roomlight.v1") ? "roomlight.v1" : false;
    },
  });
  sockets.on("connection", (socket) => {
    found.sockets.push(socket);
    connected(socket);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  found.url = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
  context.after(() => {
    sockets.clients.forEach((socket) => socket.terminate());
    server.closeAllConnections();
    server.close();
  });
  return found;
}

export const problem = (status: number, retryAfter?: string): Answer => ({
  status,
  headers: {
    "content-type": "application/problem+json",
    ...(retryAfter === undefined ? {} : { "retry-after": retryAfter }),
  },
  body: JSON.stringify({
    type: "about:blank",
    title: "Refused",
    status,
    detail: "no",
    field: "depth.bytes",
    value: "1",
    rule: "2",
  }),
});

/** A binary light message. */
export function lightMessage(json: object, parts: readonly Uint8Array[]): Buffer {
  const text = Buffer.from(JSON.stringify(json));
  const length = Buffer.alloc(4);
  length.writeUInt32LE(text.length);
  return Buffer.concat([Buffer.from("RLL1"), length, text, ...parts]);
}
