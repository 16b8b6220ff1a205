"""The house colours of figures; a page gives them in two themes."""

INK, BLUE, ORANGE, GREEN, RED, GREY, GRID = (
    "#22272e", "#1f6feb", "#d9730d", "#2da44e", "#cf222e", "#8c959f", "#eaeef2",
)  # fmt: skip
BEFORE, AFTER = "#d55e00", "#0072b2"
"""Vermilion and blue of Okabe and Ito: told apart by every kind of colour vision."""
PURPLE, TEAL = "#8250df", "#1b7c83"
