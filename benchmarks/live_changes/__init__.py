"""What `steerd learn` notices and names while the blind test's car drives figure-eights."""
