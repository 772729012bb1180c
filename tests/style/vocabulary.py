"""Words that no textbook has, as regular expressions, with what to say instead; and how hard a text is to read."""

import re

import readability

WORDS = {
    r"beside": "together with, in addition to, next to",
    r"nil": "zero, not significant",
    r"closure": "the residual is white; explains the error",
    r"(leav(es?|ing)|left)[ _]over": "residual",
    r"loud(er|est|ness)?": "noisy, noise level, noise scale",
    r"rehears\w*": "bootstrap replicate",
    r"anonymous|without a name": "generic, nonparametric",
    r"(kept|keeps?|keeping)[ _]back": "held-out runs, test runs",
    r"matters?": "material; changes the simulation by more than the threshold",
    r"strays?|r[ua]ns?[ _](off|away)": "diverges",
    r"fore(tells?|told|sees?|seen|saw)": "predict",
    r"mend(s|ed|ing)?": "fix",
    r"passages?": "zero crossing of the velocity",
    r"stretch(es|ed|ing)?": "segment",
    r"haste": "step factor",
    r"steep(er|est|ness)?": "name the quantity",
    r"foreign": "imported, another program's",
    r"(by|on) (itself|themselves)|(by|on) (its|their) own account": "individually, separately, alone",
    r"in (its|their) turn": "rotate, leave-one-out, k-fold",
    r"doubt(s|ed|ful|ing)?": "suspect, flagged, finding",
    r"the print": "the paper",
    r"ma[dk]es? out of": "generate from",
    r"friction('?s)?[ _]round\w+|round(ing|ed)([ _]off)? (friction|sign|law)|sign(\(\w+\))? is round\w+":
        "smoothing velocity, smoothed sign",
}
"""In packages and pages."""
IN_ESTIMATOR = {
    r"readers?": "the model whose smoother supplies the pivot angle",
    r"pull(s|ed|ing)?": "gradient, torque",
    r"round(ing|ed)": "smoothing velocity, smoothed sign",
    r"settl(es?|ed|ing)": "converge",
}
"""In the estimator: elsewhere a reader reads files, a pull-up is a resistor and settling takes a time."""
IN_PAGES = {
    r"closes|closures": "the residual is white; explains the error",
    r"rounded (sign|off)|speed of rounding": "smoothed sign, friction smoothing velocity",
    r"settl\w+|unsettled": "converge",
    r"without names": "generic",
    r"(as|where) (it|that) (does|is) where|of one run nothing": "subject, verb, object",
}
"""In pages alone."""


def compiled(words: dict[str, str]) -> list[tuple[re.Pattern[str], str]]:
    return [(re.compile(rf"(?<![a-z])({word})(?![a-z])", re.IGNORECASE), say) for word, say in words.items()]


def lix(texts: list[str]) -> float:
    """LIX (Björnsson, 1968) of sentences, without code and numbers, by the library `readability`.

    Words a sentence plus the percentage of words with more than six letters: 30 is easy, 40 a newspaper, 50 hard.
    """
    words = [re.findall(r"[A-Za-z][A-Za-z'-]*", text.replace("`CODE`", "it")) for text in texts]
    lines = [" ".join(sentence) for sentence in words if len(sentence) > 2]  # shorter ones are items and labels
    return float(readability.getmeasures(lines, lang="en")["readability grades"]["LIX"])
