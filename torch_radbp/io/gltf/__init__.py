"""Reads and writes glTF 2.0, `.glb` and `.gltf`.

In: `container` (bytes to JSON), `document` (JSON to checked values), `accessor`, `picture` and `nodes` (what the JSON refers
to), `texture`, `material`, `extension`, `primitive` and `lamp` (plugins), `read`. Out: `surface`, `image_slot`, `appearance`
and `lamp_out` (plugins to objects), `written` (objects to a document), `write`.

A document is plain JSON, since libraries hand it on unchecked, and a file may come from anywhere: every value is checked
where it is read.

Reference: Khronos Group 2021, "glTF 2.0 Specification", and its ratified extensions.
"""
