"""`--lambda0 0.5 1`: several values after one option, where click alone wants the option before each."""

from itertools import takewhile

from typer.core import TyperCommand


def _is_word(word: str) -> bool:
    return not word.startswith("-")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


class SpacedNumbers(TyperCommand):
    """A command whose repeatable options take any number of numbers after them."""

    is_value = staticmethod(_is_number)

    def parse_args(self, ctx, args):
        """Repeat the option before each of its values, then parse as ever."""
        repeatable = {name for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        spread, rest = [], list(args)
        while rest:
            word = rest.pop(0)
            values = list(takewhile(self.is_value, rest)) if word in repeatable else []
            spread += [part for value in values for part in (word, value)] or [word]
            rest = rest[len(values) :]
        return super().parse_args(ctx, spread)


class SpacedWords(SpacedNumbers):
    """A command whose repeatable options take all words after them, up to the next option."""

    is_value = staticmethod(_is_word)
