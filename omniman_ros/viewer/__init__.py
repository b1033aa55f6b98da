"""The page in the browser: what it knows (numpy only) and how it is drawn (viser)."""
