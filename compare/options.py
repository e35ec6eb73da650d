"""`--lambda0 0.5 1`: several numbers after one option, where click alone wants the option before each."""

from itertools import takewhile

from typer.core import TyperCommand


class SpacedNumbers(TyperCommand):
    """A command whose repeatable options take any number of numbers after them."""

    def parse_args(self, ctx, args):
        """Repeat the option before each of its numbers, then parse as ever."""
        repeatable = {name for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        spread, rest = [], list(args)
        while rest:
            word = rest.pop(0)
            values = list(takewhile(_is_number, rest)) if word in repeatable else []
            spread += [part for value in values for part in (word, value)] or [word]
            rest = rest[len(values) :]
        return super().parse_args(ctx, spread)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
