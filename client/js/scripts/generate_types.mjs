// Generates TypeScript from the document of openapi.py: `openapi.py | node generate_types.mjs > ../src/schemas.ts`.

import { text } from "node:stream/consumers";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const HEADER = `\
// Generated from the server's OpenAPI document by \`npm run generate\`. Do not edit.
// Units: world metres (y up), seconds, milliseconds where a name says so. Light is linear RGB; 1.0 is the radiance that
// the session's reference exposure shows as white. docs/wire.md specifies the format.

`;
const EMPTY = ["paths", "webhooks", "operations", "$defs"]; // the document has schemas only

/** A position as a read-only tuple; the option `arrayLength` generates only mutable ones. */
function transform({ type, items, minItems, maxItems }) {
    if (type === "array" && items.type === "number" && minItems === 3 && maxItems === 3) {
        const { createKeywordTypeNode, createTupleTypeNode, createTypeOperatorNode } = ts.factory;
        const tuple = createTupleTypeNode(Array(3).fill(createKeywordTypeNode(ts.SyntaxKind.NumberKeyword)));
        return createTypeOperatorNode(ts.SyntaxKind.ReadonlyKeyword, tuple);
    }
    return undefined;
}

const types = await openapiTS(JSON.parse(await text(process.stdin)), {
    defaultNonNullable: false, // openapi.py decides which fields are required
    immutable: true,
    rootTypes: true,
    rootTypesNoSchemaPrefix: true,
    transform,
});
const compact = astToString(types.filter(({ name }) => !EMPTY.includes(name?.text)))
    .replace(/^ *(\/\*\* @enum \{string\} \*\/|\* @enum \{string\})\n/gm, "") // the union says so
    .replace(/\/\*\*\n *\* (.*)\n *\*\//g, "/** $1 */")
    .replace(/\[\n *number,\n *number,\n *number\n *\]/g, "[number, number, number]")
    .replace(/(\?: .*);$/gm, "$1 | undefined;"); // for exactOptionalPropertyTypes
process.stdout.write(HEADER + compact);
