"""Stage 8: is a plane more than noise makes?"""
