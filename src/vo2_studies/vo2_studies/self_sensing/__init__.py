"""Studies of chapter 7: self-sensing schemes by number of levels and by speed."""
