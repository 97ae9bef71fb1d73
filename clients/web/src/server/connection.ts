/** The services of one server over gRPC-Web, with a token where the server wants one. */

import { type Client, Code, ConnectError, type Interceptor, createClient } from "@connectrpc/connect";
import { createGrpcWebTransport } from "@connectrpc/connect-web";
import { ExerciseService } from "../generated/sightline/v1/exercise_pb";
import { LineOfSightService } from "../generated/sightline/v1/line_of_sight_pb";
import { SceneService } from "../generated/sightline/v1/scene_pb";
import { TerrainService } from "../generated/sightline/v1/terrain_pb";

/** How long a single call may take, in milliseconds. */
export const CALL_MS = 10_000;

export interface Server {
  readonly terrain: Client<typeof TerrainService>;
  readonly lines: Client<typeof LineOfSightService>;
  readonly exercises: Client<typeof ExerciseService>;
  readonly scenes: Client<typeof SceneService>;
}

/** A server by the address of its port. `token` is asked before each call; empty: none. */
export function connect(baseUrl: string, token: () => string = () => ""): Server {
  const authorize: Interceptor = (next) => (request) => {
    if (token()) request.header.set("authorization", `Bearer ${token()}`);
    return next(request);
  };
  const transport = createGrpcWebTransport({ baseUrl, interceptors: [authorize], fetch: (input, init) => fetch(input, { ...init, keepalive: isLeaving }) });
  return {
    terrain: createClient(TerrainService, transport),
    lines: createClient(LineOfSightService, transport),
    exercises: createClient(ExerciseService, transport),
    scenes: createClient(SceneService, transport),
  };
}

let isLeaving = false;

/** From now on calls are carried to their end although the page goes. */
export function leave(): void {
  isLeaving = true;
}

/** Whether a call failed because the server cannot be reached, not because it refused. */
export function isAway(error: unknown): boolean {
  const { code } = ConnectError.from(error);
  return code === Code.Unavailable || code === Code.Unknown || code === Code.Canceled || code === Code.DeadlineExceeded || code === Code.Aborted;
}

/** What an error says, for people. */
export function said(error: unknown): string {
  return error instanceof Error ? ConnectError.from(error).rawMessage : String(error);
}

export { Code, ConnectError };
