"""Topics of the recorder's own records, in a module without their models, which a summary from the index spares."""

GAP_TOPIC = "recorder/gap"
REJECTED_TOPIC = "recorder/rejected"
RECORD_TOPICS = frozenset((GAP_TOPIC, REJECTED_TOPIC))
