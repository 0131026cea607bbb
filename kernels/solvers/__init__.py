"""From moments to planes: closed forms and eigenvectors. Uses `moments` and what is below it."""
