"""The wire protocol, version 1: every message, closed set and subprotocol is defined here and nowhere else.

The service, the Python client, both contracts (OpenAPI, AsyncAPI), ``mfcmt.d.ts`` and the tables of docs/protocol.md
are made from these definitions. Nothing here needs numpy or FastAPI.

======================  ================================================================================
module                  holds
======================  ================================================================================
``enums``               the closed sets: status, mode, preset, problem code, close code, …
``values``              boxes, regions, frame numbers and echoed values: their types and checks
``target``              a target in one frame, as a message and as a row of plain values
``answers``             what the service sends: results, sessions, stream messages
``capabilities``        what the service can do and accepts
``requests``            what a client sends: frames, controls, options; with their checks
``problems``            the catalogue of problems and the one exception that refuses
``documents``           JSON and MessagePack, bounded where they come from outside
``codecs``              the subprotocols of a stream, by name
``schema``, ``examples``  JSON Schemas of the messages, and one example of each
======================  ================================================================================
"""
