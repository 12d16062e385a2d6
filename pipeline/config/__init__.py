"""One typed settings model per stage; YAML defaults and JSON schema are generated from them."""
