"""The conformance kit: checks a client in any language on the wire against the rules of proto/SPEC.md."""
