"""Light scored on captures: panoramas, main light, predicted views; and the rule that chooses the default model."""
