// Measure a session with openapi-fetch and the generated types: `measure.js URL KEY MANIFEST`.
import { readFile } from "node:fs/promises";
import { setTimeout as pause } from "node:timers/promises";
import createClient from "openapi-fetch";
import type { components, paths } from "./gridpose.js";

type Manifest = {
  target: components["schemas"]["TargetCreate"];
  cycles: number;
  rp_l_mm: number;
  tolerance: number;
  images: { path: string; pose_id: string; cycle: number; sha256: string }[];
};

function answer<T>(result: { data?: T; error?: unknown }): T {
  if (result.data === undefined) throw new Error(JSON.stringify(result.error));
  return result.data;
}

const [url, key, manifestPath] = process.argv.slice(2) as [string, string, string];
const manifest = JSON.parse(await readFile(manifestPath, "utf-8")) as Manifest;
const client = createClient<paths>({ baseUrl: url, headers: { Authorization: `Bearer ${key}` } });

const target = answer(await client.POST("/v1/targets", { body: manifest.target }));
const session = answer(
  await client.POST("/v1/sessions", { body: { name: "TypeScript", target_ids: [target.id] } }),
);
for (const image of manifest.images) {
  const bytes = await readFile(image.path);
  answer(
    await client.PUT("/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}", {
      params: {
        path: { session_id: session.id, pose_id: image.pose_id, sha256: image.sha256 },
        query: { cycle: image.cycle },
      },
      headers: { "Content-Type": "application/octet-stream" },
      body: "", // the types have binary bodies as strings; the serializer sends the bytes
      bodySerializer: () => bytes,
    }),
  );
}
const path = { session_id: session.id };
for (const deadline = Date.now() + 60_000; ; await pause(100)) {
  const { counts } = answer(await client.GET("/v1/sessions/{session_id}", { params: { path } }));
  if (counts.queued + counts.running === 0) break;
  if (Date.now() > deadline) throw new Error(JSON.stringify(counts));
}
const table = answer(await client.GET("/v1/sessions/{session_id}/repeatability", { params: { path } }));
if (typeof table === "string") throw new Error("a CSV table, which was not asked for");
const row = table.poses.find((each) => each.pose_id === "P1");
const measured = row?.repeatability.rp_l_mm;
if (row === undefined || measured === null || measured === undefined) throw new Error("P1 has no RP_l");
if (row.cycles !== manifest.cycles) throw new Error(`${row.cycles} cycles`);
if (Math.abs(measured - manifest.rp_l_mm) > manifest.tolerance * manifest.rp_l_mm) {
  throw new Error(`RP_l ${measured} mm, truly ${manifest.rp_l_mm} mm`);
}
console.log(
  `          P1: RP_l ${measured.toFixed(3)} mm, truly ${manifest.rp_l_mm.toFixed(3)} mm, verdict ${row.verdict}`,
);
