"""How far an estimate is from the truth. The only room where the word is *error*."""
