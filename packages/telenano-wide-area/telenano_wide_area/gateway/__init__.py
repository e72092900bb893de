"""The gateway: it serves the page of rigs that dial out to it, over HTTPS, with datagrams for hand and force."""
