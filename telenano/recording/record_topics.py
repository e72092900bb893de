"""The topics of the recorder's own records, apart from their models, which a summary by the index does not need."""

GAP_TOPIC = "recorder/gap"
REJECTED_TOPIC = "recorder/rejected"
RECORD_TOPICS = frozenset((GAP_TOPIC, REJECTED_TOPIC))
