"""The conformance kit: what a client in any language does wrong on the wire, by the rules of proto/SPEC.md."""
