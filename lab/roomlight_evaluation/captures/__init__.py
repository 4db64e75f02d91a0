"""Light scored on captures: panoramas, main light, and light by estimated depth and poses."""
