"""From scores to a verdict: where, which effect, how sure, how far it helps."""
