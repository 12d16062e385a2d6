"""The keys of `capture.yaml`: their types, what they mean, and the page that documents them.

- `capture_yaml`: all keys, with `board_schema` and `known_schema` for cameras; `sections`: types they are made of.
- `manifest`: reads capture.yaml; `format_page`: writes config/capture_format.md from the models.
"""
