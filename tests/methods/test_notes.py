from posecore.methods.notes import note


def test_a_note_does_not_get_into_what_is_printed(capsys):
    note("3 estimates are ignored")
    assert capsys.readouterr() == ("", "note: 3 estimates are ignored\n")
