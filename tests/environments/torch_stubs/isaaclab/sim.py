"""Of Isaac Lab's SimulationContext the physics step, which the test sets."""


class SimulationContext:
    physics_dt = None

    @classmethod
    def instance(cls):
        return cls()

    def get_physics_dt(self):
        return self.physics_dt
