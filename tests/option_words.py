"""Fields as words of a command line."""


def text(value):
    """Return a value as an option has it."""
    if isinstance(value, list | tuple):
        return ",".join(map(text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def options_of(fields, start="--model."):
    """Return the options of fields."""
    return [
        word
        for name, value in fields.items()
        for word in (f"{start}{name.replace('_', '-')}", text(value))
    ]


def changes_of(fields):
    """Return fields, nested at most once, as the words of ``--changes``."""
    return [
        f"{name}{inner}={text(value)}".replace("_", "-", name.count("_") + inner.count("_"))
        for name, group in fields.items()
        for inner, value in (
            ((f".{key}", value) for key, value in group.items())
            if isinstance(group, dict)
            else [("", group)]
        )
    ]
