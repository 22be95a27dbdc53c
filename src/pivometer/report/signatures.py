"""Who signs, and for what."""

from pivometer.measurement import Measurement

SEALED = (
    "Whoever signs stands for the result with the SHA-256 stated under Provenance, as far as their "
    "role goes."
)


def roles(measurement: Measurement) -> tuple[tuple[str, str], ...]:
    """Return the roles that sign, each with the name that ``session.toml`` gives, or none."""
    operator = measurement.setup.operator
    checker = operator.get("checked_by", "")
    return (("Measured by", str(operator.get("name", ""))), ("Checked by", str(checker)))
