// What the types name and what is there: JSON of both, export by export.
import { fileURLToPath } from "node:url";
import ts from "typescript";
import * as client from "../../../service/web/client/mfcmt.js";

const types = fileURLToPath(new URL("../../../service/web/client/mfcmt.d.ts", import.meta.url));
const program = ts.createProgram([types], { lib: ["lib.es2022.d.ts", "lib.dom.d.ts"], types: [] });
const source = program.getSourceFile(types);

const declared = {};
for (const node of source.statements) {
  if (ts.isClassDeclaration(node)) {
    const names = node.members.filter((member) => member.name).map((member) => member.name.getText(source));
    declared[node.name.text] = [...new Set(names)].sort();
  } else if (ts.isFunctionDeclaration(node)) {
    declared[node.name.text] = null;
  } else if (ts.isVariableStatement(node)) {
    declared[node.declarationList.declarations[0].name.text] = null;
  }
}

class NoSocket {
  close() {}
  send() {}
}
const own = (object) => Object.getOwnPropertyNames(object);
const session = new client.Session({}, { id: "x" });
const stream = new client.Client({ WebSocket: NoSocket, fetch: () => {} }).stream("x");
stream.close();
const instances = {
  MFCMTError: new client.MFCMTError({ code: "internal" }),
  Client: new client.Client(),
  Session: session,
  Stream: stream,
};
const inherited = new Set(["name", "message", "stack", "cause", "constructor"]);
// The rest is between the client's own modules.
const internal = {
  Client: ["timeoutMs", "key", "WebSocket", "msgpack", "workerUrl", "streamUrl", "json", "call", "missed", "image", "scale", "openWorker", "findPlace", "places"],
};

const present = {};
for (const [name, value] of Object.entries(client)) {
  const instance = instances[name];
  if (!instance) {
    present[name] = null;
    continue;
  }
  const symbols = value.prototype[Symbol.asyncIterator] ? ["[Symbol.asyncIterator]"] : [];
  const names = [...own(instance), ...own(value.prototype), ...own(Object.getPrototypeOf(value.prototype)), ...symbols];
  const ours = names.filter((each) => !inherited.has(each) && !(each in Object.prototype) && !internal[name]?.includes(each));
  present[name] = [...new Set(ours)].sort();
}
console.log(JSON.stringify({ declared, present }));
