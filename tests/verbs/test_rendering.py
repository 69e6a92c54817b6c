"""Tables as text: what is in a cell is what is printed."""

from jaxact.verbs import rendering


def test_units_in_brackets_and_names_between_colons_are_printed():
    made = rendering.table("joint", "delay [ms]", "gain [rad]")
    made.add_row("legs[left]:knee:", "[red]3[/red]", ":cat:")
    text = rendering.rendered(made, "path [a-b]", width=80)
    for cell in ("delay [ms]", "gain [rad]", "legs[left]:knee:", "[red]3[/red]", ":cat:", "[a-b]"):
        assert cell in text
