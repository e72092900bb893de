"""Two sites over a wide area: sealed datagrams, a relay, and the fetch of the other site's recording."""
