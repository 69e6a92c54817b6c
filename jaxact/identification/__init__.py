"""From logs of the real thing to the drive: models, their fit, and what is known of it."""
