"""What the force acts on: the exact mass, or a MuJoCo model; and the engines that simulate it."""
