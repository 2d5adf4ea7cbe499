"""A Sparkplug host on pysparkplug: prints each message as a line of JSON, and writes what its standard input asks for."""

import itertools
import json
import sys

import pysparkplug as sparkplug

GROUP, NODE = "plant", "edge1"


def show(_, message):
    payload = message.payload
    metrics = getattr(payload, "metrics", ())
    if isinstance(payload, sparkplug.NDeath):
        metrics = (payload.bd_seq_metric,)
    line = {
        "type": str(message.topic.message_type),
        "device": message.topic.device_id,
        "metrics": {
            metric.name: {"value": metric.value, "type": metric.datatype.name, "historical": metric.is_historical}
            for metric in metrics
        },
    }
    print(json.dumps(line), flush=True)


def send(client, kind, payload, device, name, datatype, value):
    now = sparkplug.get_current_timestamp()
    metric = sparkplug.Metric(timestamp=now, name=name, datatype=datatype, value=value)
    topic = sparkplug.Topic(message_type=kind, group_id=GROUP, edge_node_id=NODE, device_id=device)
    message = sparkplug.Message(
        topic=topic, payload=payload(timestamp=now, metrics=(metric,)), qos=sparkplug.QoS.AT_MOST_ONCE, retain=False
    )
    client.publish(message, include_dtypes=True)


client = sparkplug.Client(client_id="host")
# the births, data and deaths of the node, and of its devices
NODE_KINDS, DEVICE_KINDS = ["NBIRTH", "NDEATH"], ["DBIRTH", "DDATA", "DDEATH"]
for kind in NODE_KINDS:
    topic = sparkplug.Topic(message_type=sparkplug.MessageType(kind), group_id=GROUP, edge_node_id=NODE)
    client.subscribe(topic, sparkplug.QoS.AT_MOST_ONCE, show)
for kind in DEVICE_KINDS:
    topic = sparkplug.Topic(
        message_type=sparkplug.MessageType(kind),
        group_id=GROUP,
        edge_node_id=NODE,
        device_id=sparkplug.SINGLE_LEVEL_WILDCARD,
    )
    client.subscribe(topic, sparkplug.QoS.AT_MOST_ONCE, show)
acknowledged = itertools.count(1)


def on_subscribe(*_):
    if next(acknowledged) == len(NODE_KINDS + DEVICE_KINDS):
        print("{}", flush=True)


# The first line says that the broker has accepted all subscriptions; a birth before that would be lost. pysparkplug has no such
# callback, so this is the one of its MQTT client.
client._client.on_subscribe = on_subscribe
client.connect("127.0.0.1", port=int(sys.argv[1]))

for line in sys.stdin:
    match line.split():
        case ["rebirth"]:
            name = "Node Control/Rebirth"
            boolean = sparkplug.DataType.BOOLEAN
            send(client, sparkplug.MessageType.NCMD, sparkplug.NCmd, None, name, boolean, True)
        case ["write", device, name, value]:
            integer = sparkplug.DataType.INT32
            send(client, sparkplug.MessageType.DCMD, sparkplug.DCmd, device, name, integer, int(value))
client.disconnect()
