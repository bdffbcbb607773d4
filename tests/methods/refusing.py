"""A command that cannot be run says why, in one line."""

from posecore.methods.main import main


def refused(capsys, words, message):
    capsys.readouterr()
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1 and err.startswith("error: "), err
    assert message in err
