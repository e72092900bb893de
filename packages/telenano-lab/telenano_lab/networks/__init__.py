"""Networks between two sites: what they did to the datagrams of the link, as traces that the link replays."""
