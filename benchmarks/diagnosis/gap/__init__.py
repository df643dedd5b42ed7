"""`longreach bench gap`: the blind benchmark of the gap diagnosis (generator and judge: sealed/)."""
