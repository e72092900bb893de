"""Networks between two sites: their measured effect on the link's datagrams, as traces that the link replays."""
