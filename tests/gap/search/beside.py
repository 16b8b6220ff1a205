"""Offers beside one fit."""

from torchid.gap.search.evidence import Offer, offers_of_each


def offers(question, fit, places=None) -> list[Offer]:
    """Every candidate's gain beside a fit; of these places alone where some are given."""
    return offers_of_each(question, [fit], [places])[0]
