"""What the network between the sites does to messages: models of delay, loss and queues, profiles, the engine."""
