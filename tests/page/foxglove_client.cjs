// A client of the Foxglove protocol that is not ours: reads every topic, decodes it by the schema served.
// node foxglove_client.cjs MODULES ADDRESS SECONDS
const path = require("path");
const from = (name) => require(path.join(process.argv[2], name));
const { FoxgloveClient } = from("@foxglove/ws-protocol");
const { parse } = from("@foxglove/rosmsg");
const { MessageReader } = from("@foxglove/rosmsg2-serialization");
const WebSocket = from("ws");

const socket = new WebSocket(process.argv[3], ["foxglove.sdk.v1", FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const channels = new Map(), result = { topics: {}, services: {}, parameters: [], answers: [], errors: [] };
client.on("error", (error) => result.errors.push(String(error.message || error)));
client.on("advertise", (found) => {
  for (const channel of found) {
    const id = client.subscribe(channel.id);
    const reader = channel.encoding === "cdr" ? new MessageReader(parse(channel.schema, { ros2: true })) : null;
    channels.set(id, { channel, reader });
    result.topics[channel.topic] = { type: channel.schemaName, encoding: channel.encoding, count: 0 };
  }
});
client.on("message", ({ subscriptionId, data }) => {
  const { channel, reader } = channels.get(subscriptionId), topic = result.topics[channel.topic];
  try {
    if (reader) topic.last = Object.keys(reader.readMessage(data)).join(" ");
    topic.count++;
  } catch (error) { result.errors.push(`${channel.topic}: ${error.message}`); }
});
client.on("advertiseServices", (services) => {
  for (const service of services) {
    result.services[service.name] = service.type;
    if (service.name.endsWith("/reset")) {
      setTimeout(() => client.sendServiceCallRequest({ serviceId: service.id, callId: 1, encoding: "cdr", data: new DataView(new Uint8Array([0, 1, 0, 0, 0]).buffer) }), 3000);
    }
  }
});
client.on("serviceCallResponse", (answer) => result.answers.push(Buffer.from(answer.data.buffer, answer.data.byteOffset, answer.data.byteLength).toString("latin1")));
client.on("serviceCallFailure", (answer) => result.answers.push("failed: " + answer.message));
client.on("parameterValues", ({ parameters }) => { result.parameters = parameters.map((p) => [p.name, p.value]); });
client.on("open", () => {
  setTimeout(() => client.setParameters([{ name: "/rig.preload", value: 61.5 }], "set"), 4000);
  setTimeout(() => client.getParameters(["/rig.preload", "/rig.impact_impulse"], "get"), 6000);
});
setTimeout(() => { console.log(JSON.stringify(result)); process.exit(0); }, 1000 * Number(process.argv[4]));
