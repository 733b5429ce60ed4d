# Texts of the forms that come before anything else. The cell writes these pages: each text on one line.

## Log in
login-title = { $cell } : connexion
login-name = Nom
login-name-or-page = Nom (laissez vide pour utiliser le mot de passe de la page d’état)
login-password = Mot de passe
login-password-of-page = Mot de passe de la page d’état de { $cell }
login-button = Se connecter
login-code = J’ai un code
login-wrong = Nom ou mot de passe incorrect.
login-wrong-password = Mot de passe incorrect.
login-wait = Aucun mot de passe n’est accepté pendant { $wait_s } s : il y en a eu trop de faux, ou un autre est en cours de vérification. Réessayez ensuite.

## Come in by a code
invite-title = { $cell } : code
invite-what = Le code se trouve dans le journal de la cellule, ou vient de { $command }. Il sert une seule fois, et fait de vous un ingénieur.
invite-code = Code
invite-name = Votre nom
invite-password = Mot de passe, au moins { $least } caractères
invite-again = Répétez le mot de passe
invite-wrong = Ce code est faux, déjà utilisé, destiné à un autre nom, ou date de plus d’un jour. { $command } en crée un nouveau.
invite-differ = Les deux mots de passe diffèrent.
invite-short = Saisissez un nom, et un mot de passe d’au moins { $least } caractères.
invite-common = Ce mot de passe se devine trop facilement. Choisissez-en un de plusieurs mots, sans votre nom.
invite-storage = Vous ne pouvez pas devenir ingénieur : { $detail }
