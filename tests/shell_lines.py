"""Reads the ``sh`` blocks of the documentation as a shell would, without running them."""

import re
import shlex


def commands(block):
    r"""Split a block into commands, each a list of words.

    Comments and redirections are left out, continued lines joined, and arithmetic expansions taken
    for a number.

    Examples:
        >>> commands("a 'b c' \\\n  --d  # e\nF=1 g | h $((2 * I)) > i")
        [['a', 'b c', '--d'], ['F=1', 'g'], ['h', '0']]
    """
    text = re.sub(r"(?m)(^|\s)#.*$", r"\1", block).replace("\\\n", " ")
    text = re.sub(r"\s>\s*\S+", "", text)
    lexer = shlex.shlex(re.sub(r"\$\(\(.*?\)\)", "0", text), posix=True, punctuation_chars="\n;|&")
    lexer.whitespace, lexer.whitespace_split, lexer.commenters = " \t", True, ""
    found = [[]]
    for word in lexer:
        if set(word) <= set("\n;|&"):
            found.append([])
        else:
            found[-1].append(word)
    return [words for words in found if words]


def calls(block, program):
    r"""Return the arguments of each call of a program in a block.

    The program may have a path, and variables or a launcher before it.

    Examples:
        >>> calls("X=1 .venv/bin/ffpose info\ntorchrun --no-python ffpose train", "ffpose")
        [['info'], ['train']]
    """
    found = []
    for words in commands(block):
        places = [n for n, word in enumerate(words) if word.rpartition("/")[2] == program]
        if places:
            found.append(words[places[0] + 1 :])
    return found
