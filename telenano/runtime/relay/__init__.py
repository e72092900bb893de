"""How a machine that can only dial out reaches another such machine through a relay."""
