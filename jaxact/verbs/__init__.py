"""What a person asks of a loop: margins, boundary, simulation, sweep and tuning."""
